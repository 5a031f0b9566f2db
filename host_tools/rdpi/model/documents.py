"""Documents with types: a dataclass per section, to JSON and back by its type hints, and the JSON schema of them.

A key of the JSON object is a field of the class, which `json_key` gives a meaning and a unit for the schema.
"""

from __future__ import annotations

import dataclasses
import inspect
import types
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, Literal, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from ..errors import BadInput

DRAFT = "https://json-schema.org/draft/2020-12/schema"
SCALARS = {str: "string", float: "number", int: "integer", bool: "boolean"}


def json_key(meaning: str, unit: str = "", *, omitted: bool = False, needed: bool | None = None,
             low: float | None = None, high: float | None = None, holds: Any = None, **default: Any) -> Any:
    """A field that is a key of a JSON object; `default` or `default_factory` as for any field.

    omitted: the key is only written if the value is not None. needed: whether a file must have it; None: if there is no
    default. low, high: of a number, or of each number in a list. holds: the type in a document that rdpi writes, where
    the field itself takes any JSON.
    """
    if omitted:
        default = {"default": None}
    about = {"meaning": meaning, "unit": unit, "omitted": omitted, "low": low, "high": high, "holds": holds,
             "needed": not default if needed is None else needed}
    return field(metadata=about, **default)


@dataclass
class Document:
    """A JSON object. A reader keeps the keys that it does not know in `extra`."""

    SCHEMA: ClassVar[str | None] = None  # value of the key "schema", which stands first; None: there is no such key

    extra: dict[str, Any] = field(default_factory=dict, kw_only=True, repr=False)

    def to_json(self) -> dict[str, Any]:
        """The object as the json module writes it."""
        document = dict(self.extra)
        if self.SCHEMA is not None:
            document["schema"] = self.SCHEMA
        for item, hint in _keys(type(self)):
            value = getattr(self, item.name)
            if value is not None or not item.metadata["omitted"]:
                document[item.name] = _plain(value, hint)
        return document

    @classmethod
    def from_json(cls, value: Any, where: str = "document") -> Self:
        """Read an object. Numbers and texts are taken as they are.

        Raises BadInput, naming the key, for a key that is missing and for what is no object or list where one must be.
        """
        if not isinstance(value, dict):
            raise BadInput(f"{where}: must be an object")
        rest, found = dict(value), {}
        if cls.SCHEMA is not None and rest.pop("schema", None) != cls.SCHEMA:
            raise BadInput(f'{where}.schema: must be "{cls.SCHEMA}"')
        for item, hint in _keys(cls):
            if item.name in rest:
                found[item.name] = _typed(rest.pop(item.name), hint, f"{where}.{item.name}")
            elif item.metadata["needed"]:
                raise BadInput(f"{where}.{item.name}: is missing")
        return cls(**found, extra=rest)


def schema(kind: type[Document], title: str) -> dict[str, Any]:
    """The JSON schema of a document, with the schemas of its sections. Unknown keys are allowed."""
    sections: dict[str, dict[str, Any]] = {}
    whole = _object(kind, sections)
    found = {"$schema": DRAFT, "title": title, **whole}
    return found | ({"$defs": dict(sorted(sections.items()))} if sections else {})


@lru_cache(maxsize=None)
def _keys(kind: type[Document]) -> tuple[tuple[dataclasses.Field, Any], ...]:
    """The fields that are keys, with their types."""
    hints = get_type_hints(kind)
    return tuple((item, hints[item.name]) for item in dataclasses.fields(kind) if "meaning" in item.metadata)


def _options(hint: Any) -> list[Any]:
    """The types of a union without None; of any other type that alone."""
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else [hint]
    return [option for option in options if option is not type(None)]


def _is_document(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Document)


def _plain(value: Any, hint: Any) -> Any:
    """JSON of a value of this type."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or isinstance(value, Document):
        return None if value is None else value.to_json()
    hint = next((option for option in _options(hint) if not _is_document(option)), Any)
    part = (get_args(hint) or (Any,))[-1]
    if get_origin(hint) is dict:
        return {name: _plain(one, part) for name, one in value.items()}
    if hint is np.ndarray or get_origin(hint) in (list, tuple):
        return [_plain(one, float if hint is np.ndarray else part) for one in value]
    return float(value) if hint is float else value


def _typed(value: Any, hint: Any, where: str) -> Any:
    """A value of this type, of JSON; arrays do for lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    options = _options(hint)
    section = next((option for option in options if _is_document(option)), None)
    if value is None and type(None) in get_args(hint):
        return None
    if section is not None and (isinstance(value, dict) or len(options) == 1):
        return section.from_json(value, where)
    hint = next((option for option in options if option is not section), Any)
    part = (get_args(hint) or (Any,))[-1]
    if get_origin(hint) is dict:
        if not isinstance(value, dict):
            raise BadInput(f"{where}: must be an object")
        return {name: _typed(one, part, f"{where}.{name}") for name, one in value.items()}
    if get_origin(hint) in (list, tuple):
        if not isinstance(value, (list, tuple)):
            raise BadInput(f"{where}: must be a list")
        return get_origin(hint)(_typed(one, part, f"{where}[{k}]") for k, one in enumerate(value))
    return value


def _object(kind: type[Document], sections: dict[str, dict[str, Any]]) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    if kind.SCHEMA is not None:
        properties["schema"] = {"const": kind.SCHEMA, "description": "format and its version"}
    for item, hint in _keys(kind):
        about = item.metadata
        hint = about["holds"] or (_options(hint)[0] if about["omitted"] else hint)
        properties[item.name] = {**_schema_of(hint, sections, about["low"], about["high"]),
                                 "description": about["meaning"]} | ({"unit": about["unit"]} if about["unit"] else {})
    needed = [item.name for item, _ in _keys(kind) if item.metadata["needed"]]
    if kind.SCHEMA is not None:
        needed.insert(0, "schema")
    about_it = inspect.getdoc(kind).partition("\n\n")[0]  # the rest is about the Python class
    return {"type": "object", "description": " ".join(about_it.split()), "properties": properties, "required": needed}


def _schema_of(hint: Any, sections: dict[str, dict[str, Any]], low: float | None, high: float | None
               ) -> dict[str, Any]:
    options, part = _options(hint), (get_args(hint) or (Any,))[-1]
    nullable = type(None) in get_args(hint)
    if len(options) > 1 or nullable:
        found = [_schema_of(option, sections, low, high) for option in options] + [{"type": "null"}] * nullable
        if len(found) == 2 and set(found[0]) >= {"type"} and isinstance(found[0]["type"], str) and nullable:
            return {**found[0], "type": [found[0]["type"], "null"]}
        return {"anyOf": found}
    if _is_document(hint):
        if hint.__name__ not in sections:
            sections[hint.__name__] = {}  # holds its place: a section may hold itself
            sections[hint.__name__] = _object(hint, sections)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    if hint is Any:
        return {}
    if get_origin(hint) is Literal:
        return {"enum": list(get_args(hint))}
    if get_origin(hint) is dict:
        return {"type": "object", "additionalProperties": _schema_of(part, sections, low, high)}
    if hint is np.ndarray or get_origin(hint) in (list, tuple):
        part = float if hint is np.ndarray else part
        length = len(get_args(hint)) if get_origin(hint) is tuple else None
        return {"type": "array", "items": _schema_of(part, sections, low, high)} | (
            {} if length is None else {"minItems": length, "maxItems": length})
    ends = {} if low is None else {"minimum": low}
    return {"type": SCALARS[hint]} | ends | ({} if high is None else {"maximum": high})
