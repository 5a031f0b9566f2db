"""Where results are written: refused, before any work, are files that cannot be written or would overwrite another."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

from ..errors import BadInput


def is_device(path: str | os.PathLike[str]) -> bool:
    """Whether something that is no ordinary file is there: a device, a pipe, a directory."""
    return os.path.exists(path) and not os.path.isfile(path)


def same_file(one: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to one file, which may not exist yet."""
    if os.path.exists(one) and os.path.exists(other):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


def check_outputs(outputs: Sequence[str], inputs: Collection[str] = (), made: str | None = None,
                  folders: Collection[str] = (), kept: Collection[str] = ()) -> None:
    """Raise BadInput for an output that cannot be written, or that is an input, kept with a model or another output.

    The caller makes the directory `made`. An output that is listed in `folders` and ends with "/" is a directory,
    which the caller makes too. Devices may be given several times.
    """
    if made is not None:
        check_made(made, outputs)
    for k, name in enumerate(outputs):
        _check_folder(name, made, folders)
        if os.path.isdir(name) and name not in folders:
            raise BadInput(f"{name}: is a directory; give another name")
        for other in (*inputs, *kept, *outputs[:k]):
            if os.path.realpath(name) == os.path.realpath(other) and os.path.basename(name) and not is_device(name):
                kind = "an input" if other in inputs else \
                    "a recording that is kept with the model" if other in kept else "another output"
                raise BadInput(f"{name}: would be written over {kind}; give another name")


def check_no_table(name: str) -> None:
    """Raise BadInput if a JSON document would be written over a table, by its name: a recording, as a rule."""
    if name.lower().endswith(".csv") and os.path.isfile(name):
        raise BadInput(f"{name}: is a table that is there already, and JSON would be written over it; give another name")


def check_made(made: str, outputs: Sequence[str], option: str = "--report", chosen: str = "") -> None:
    """Raise BadInput unless the directory of an option is there or can be made, and is none of the outputs.

    Where the command chooses names that end in `chosen` itself, no output may have such a name in there.
    """
    above = Path(made)
    while not os.path.lexists(above) and above != above.parent:
        above = above.parent
    if not above.is_dir():
        raise BadInput(f"{above}: is not a directory; give another name for {option}")
    if not os.access(above, os.W_OK):
        raise BadInput(f"{made}: you may not write to the directory {above}; check its permissions")
    for name in outputs:
        if same_file(name, made):
            raise BadInput(f"{name}: is the directory of {option} too; give another name")
        if chosen and name.endswith(chosen) and same_file(os.path.dirname(os.path.realpath(name)), made):
            raise BadInput(f"{name}: could be one of the files of {option}; give another name or directory")


def _check_folder(name: str, made: str | None, folders: Collection[str]) -> None:
    """Raise BadInput unless files can be written to the directory of this output, or in this directory."""
    folder = os.path.dirname(name) or "."
    makes_folder = made is not None and os.path.normpath(folder) == os.path.normpath(made) or \
        name in folders and name.endswith("/")
    if not os.path.isdir(folder) and not makes_folder:
        raise BadInput(f"{name}: there is no directory {folder}; create it first")
    into = name if os.path.isdir(name) else os.path.dirname(os.path.realpath(name))
    if os.path.isdir(into) and (into == name or not is_device(name)) and not os.access(into, os.W_OK):
        raise BadInput(f"{name}: you may not write to the directory {into}; check its permissions")
    if os.path.isfile(name) and not os.access(name, os.W_OK):
        raise BadInput(f"{name}: is there already and protected against writing; give another name, or lift its protection")


def targets(sources: Sequence[str], output: str, others: Sequence[str] = (), numbered: bool = False) -> list[Path]:
    """The file to write for each source: `output`, or NAME.csv in the directory `output`.

    `output` is a directory if it is one already, if it ends with "/", or if there are several sources.
    Raises BadInput where two sources have one target, and as `check_targets` does.
    """
    folder = Path(output)
    if len(sources) == 1 and not folder.is_dir() and not output.endswith("/"):
        found = [folder]
    elif len(sources) > 1 and not folder.is_dir() and (folder.exists() or folder.suffix):
        raise BadInput(f"-o {output}: several sources need a directory; give one, e.g. -o runs/")
    else:
        found = [folder / f"{Path(source).stem}.csv" for source in sources]
    for index, target in enumerate(found):
        if target in found[:index]:
            first = sources[found.index(target)]
            raise BadInput(f"{sources[index]} and {first} would both be written to {target}; import them separately")
    check_targets(found, sources, others, numbered)
    return found


def check_targets(found: Sequence[Path], inputs: Sequence[str] = (), others: Sequence[str] = (),
                  numbered: bool = False) -> None:
    """Raise BadInput for a target that is an input, or one of the `others`, which are written too.

    With `numbered` a target RUN.csv stands for RUN-1.csv, RUN-2.csv and so on, as many as there may be.
    """
    for target in found:
        for file in _numbered(target, others) if numbered else [target]:
            for other in (*inputs, *others):
                if same_file(file, other) and not is_device(other):
                    kind = "an input" if other in inputs else "another output"
                    raise BadInput(f"{file}: would be written over {kind}; give another name or directory")


def _numbered(target: Path, others: Sequence[str]) -> list[Path]:
    """Of a family of numbered files those that exist already, and those that have the name of an output."""
    member = re.compile(re.escape(target.stem) + "-[0-9]+" + re.escape(target.suffix))
    there = target.parent.iterdir() if target.parent.is_dir() else ()
    return [target.with_name(file.name) for file in (*there, *map(Path, others)) if member.fullmatch(file.name)]
