"""What options of the command line take."""

from __future__ import annotations

from typing import Any

import click

LARGEST = 1e9


class Output(click.Path):
    """A file that the command writes; `json`: it is a JSON document, and not to be written over a table."""

    def __init__(self, dir_okay: bool = False, json: bool = False) -> None:
        super().__init__(dir_okay=dir_okay)
        self.json = json


class ModelFile(click.Path):
    """A model that the command reads."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False)


class Report(click.Path):
    """A folder that the command makes, and the files that it writes there."""

    def __init__(self, *files: str) -> None:
        super().__init__(file_okay=False)
        self.files = files


class Folder(click.Path):
    """A folder that the command makes, and where it chooses the names of files itself."""

    def __init__(self) -> None:
        super().__init__(file_okay=False)


class Percent(click.ParamType):
    """A positive finite number."""

    name = "percent"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = click.FLOAT.convert(value, param, ctx)
        if not 0 < number < float("inf"):
            self.fail(f"{value!r}: must be a positive finite number", param, ctx)
        return number


class Number(click.ParamType):
    """A finite number, as large as a voltage, a scale or a time may be."""

    name = "number"

    def __init__(self, positive: bool = False) -> None:
        self.positive = positive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = click.FLOAT.convert(value, param, ctx)
        if not -LARGEST < number < LARGEST:  # nan neither
            self.fail(f"{value!r}: must be a number within ±{LARGEST:g}", param, ctx)
        if self.positive and number <= 0:
            self.fail(f"{value!r}: must be positive", param, ctx)
        return number


class Numbers(click.ParamType):
    """Comma-separated numbers."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        try:
            return value if isinstance(value, tuple) else tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r}: give numbers separated by commas", param, ctx)


class Choices(click.ParamType):
    """Comma-separated words, each one of those given."""

    name = "choices"

    def __init__(self, *words: str) -> None:
        self.words = words

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        found = value if isinstance(value, tuple) else tuple(part.strip() for part in value.split(","))
        for word in found:
            if word not in self.words:
                self.fail(f"{word!r}: must be one of {', '.join(self.words)}", param, ctx)
        return found


def all_of(context: click.Context, parameter: click.Parameter, values: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The words of a `Choices` that may be given several times."""
    return tuple(word for one in values for word in one)


class Rows(click.ParamType):
    """START:STOP, as Python slices count."""

    name = "rows"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> slice:
        if isinstance(value, slice):
            return value
        try:
            start, stop = (int(part) if part.strip() else None for part in value.split(":"))
        except ValueError:
            self.fail(f"{value!r}: give START:STOP, e.g. 400:4400, 400: or :-100", param, ctx)
        return slice(start, stop)


class Dac(click.ParamType):
    """BITS:MIN_V:MAX_V."""

    name = "dac"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, float, float]:
        if isinstance(value, tuple):
            return value
        try:
            bits, low, high = value.split(":")
            return int(bits), float(low), float(high)
        except ValueError:
            self.fail(f"{value!r}: give BITS:MIN_V:MAX_V, e.g. 16:-20:120", param, ctx)


def pairs(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    pairs = {}
    for value in values:
        name, equals, rest = (part.strip() for part in value.partition("="))
        if not (name and equals and rest) or set(name) & set(',"#'):
            raise click.BadParameter(f"{value!r}: give NAME=COLUMN, e.g. other_axis_V=3", ctx, param)
        pairs[name] = rest
    return pairs
