"""Methods with hyper-parameters of the user's, each a row of its own.

A user writes 'gail(layers=(128, 128), mean=True)'. The method's name, in its rows and on the command line, is
'gail+layers-128x128+mean-True'.
"""

from __future__ import annotations

import ast
import dataclasses
import difflib
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from harness.registry.names import SETTING, BadInput, base
from methods.ranges import Between, OneOf

VALUE, ITEM = "-", "x"
"""Characters before a value, and between the numbers of a tuple."""
NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?(e-?[0-9]+)?")
WORD = re.compile(r"[A-Za-z0-9_.-]*")
CALL = re.compile(r"([^()]*)\((.*)\)", re.DOTALL)
LONGEST = 120
"""Characters of a method's name."""
ELSE = "name an instance with such settings in the METHODS of a plug-in (docs/plugins.md)"


@dataclass(frozen=True)
class Search:
    """The values of a setting that are searched: the ends of a range on a logarithmic scale, or words."""

    kind: Literal["int", "float", "choice"]
    values: tuple[float | str, ...]


def names_in(text: str) -> list[str]:
    """Return the names of methods in a text with commas between, those with settings as their rows have them.

    Raises BadInput for settings that cannot be read or be part of a name.
    """
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == "," and not depth:
            parts.append("")
        else:
            parts[-1] += character
    return [_name_in(part.strip()) for part in parts]


def _name_in(text: str) -> str:
    if "(" not in text:
        return text
    call = CALL.fullmatch(text)
    with suppress(SyntaxError, ValueError):
        match ast.parse(f"f({call[2]})" if call else "", mode="eval").body:
            case ast.Call(args=[], keywords=keywords) if call:
                settings = {one.arg: ast.literal_eval(one.value) for one in keywords if one.arg}
                if len(settings) == len(keywords):
                    return name_of(call[1].strip(), settings)
    raise BadInput(f"{text[:80]!r} cannot be read; settings are given as 'gail(layers=(128, 128))'")


def value_in(text: str) -> object:
    """Return the value of `--set`: a number, a truth value, a tuple, or else the text itself."""
    with suppress(SyntaxError, ValueError):
        value: object = ast.literal_eval(text)
        return value
    return text


def name_of(method: str, settings: Mapping[str, object]) -> str:
    """Return the name of a method with settings. `method` may have some already.

    Raises BadInput for values that cannot be part of a name, and for a setting that is given twice.
    """
    own = settings_in(method)
    if twice := own.keys() & settings.keys():
        raise BadInput(f"{base(method)}: {min(twice)} is given twice")
    words = {name: _word(value) for name, value in (own | dict(settings)).items()}
    for name, word in words.items():
        if word is None or not WORD.fullmatch(word) or not name.isidentifier():
            raise BadInput(f"{base(method)}.{name} cannot be part of a row's name; {ELSE}")
    name = SETTING.join([base(method), *(f"{field}{VALUE}{words[field]}" for field in sorted(words))])
    if len(name) > LONGEST:
        raise BadInput(f"{name[:80]} is longer than {LONGEST} characters; {ELSE}")
    return name


def settings_in(name: str) -> dict[str, object]:
    """Return the settings in the name of a method, none for a plain one."""
    pairs = [part.partition(VALUE) for part in name.split(SETTING)[1:]]
    return {field: _value(word) for field, _, word in pairs}


def _word(value: object) -> str | None:
    """Return a value as a word, None where `_value` could not read it."""
    if isinstance(value, tuple | list):
        word = ITEM.join(map(str, map(_word, value))) + ITEM * (len(value) < 2)
        value = tuple(value)
    elif isinstance(value, float):
        word = repr(value).removesuffix(".0").replace("+", "")
    else:
        word = str(value)
    return word if _value(word) == value else None


def _value(word: str) -> object:
    if word in ("True", "False"):
        return word == "True"
    if NUMBER.fullmatch(word):
        return float(word) if {*word} & {*".e"} else int(word)
    items = [item for item in word.split(ITEM) if item]
    if ITEM in word and all(map(NUMBER.fullmatch, items)):
        return tuple(map(_value, items))
    return word


def typed(method: str, thing: object, settings: Mapping[str, object]) -> dict[str, Any]:
    """Return the settings as a method's fields hold them. `thing`: its dataclass, or an instance.

    Raises BadInput for a setting that the method does not have, and for a value of another type or range than
    the field's annotation says.
    """
    kind = thing if isinstance(thing, type) else type(thing)
    known = [field.name for field in dataclasses.fields(kind) if field.init]
    for name in settings:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            advice = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known) or 'none'}"
            raise BadInput(f"{method} has no setting {name!r}; {advice}")
    values, hints = dict[str, Any](), get_type_hints(kind, include_extras=True) if settings else {}
    for name, value in settings.items():
        try:
            values[name] = msgspec.convert(value, hints[name])
        except msgspec.ValidationError as error:
            each = f"; for a row of each value: --methods '{method}({name}=A),{method}({name}=B)'"
            several = each if isinstance(value, tuple) else ""
            raise BadInput(f"{method}.{name} cannot be {value!r:.40}: {error}{several}") from error
        except TypeError as error:  # a type of the plug-in's own
            raise BadInput(f"{method}.{name} cannot be set here; {ELSE}") from error
    return values


def searched(thing: object) -> dict[str, Search]:
    """Return the settings of a method that are searched. `thing`: its dataclass, or an instance."""
    hints = get_type_hints(thing if isinstance(thing, type) else type(thing), include_extras=True)
    found = dict[str, Search]()
    for name, hint in hints.items():
        kind, *notes = get_args(hint) if get_origin(hint) is Annotated else [hint]
        for note in notes:
            if isinstance(note, Between):
                found[name] = Search("int" if kind is int else "float", (note.low, note.high))
            elif isinstance(note, OneOf):
                found[name] = Search("choice", tuple(str(_word(value)) for value in note.values))
    return found
