"""Read from C++ headers what Slicer's widgets offer to Python."""

import re
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Offer:
    """What a Qt class has for PythonQt: the names that Python can use."""

    properties: set = field(default_factory=set)
    methods: set = field(default_factory=set)
    slots: set = field(default_factory=set)
    signals: set = field(default_factory=set)
    base: str = ""

    def names(self) -> set:
        return self.properties | self.methods | self.slots | self.signals


SECTION = re.compile(r"^\s*(public|protected|private|signals|Q_SIGNALS)\s*(slots|Q_SLOTS)?\s*:")
PROPERTY = re.compile(r"Q_PROPERTY\(.*?\b(\w+)\s+READ\b", re.S)
FUNCTION = re.compile(r"([\w:<>*&,\s]*?)\b(\w+)\s*\(([^()]*)\)")


def offer(folders: list[Path], name: str) -> Offer:
    """Return what the class `name` offers, its base classes in these folders included.

    Parameters
    ----------
    folders : checkouts to look in for NAME.h
    """
    header = next((file for folder in folders for file in folder.rglob(f"{name}.h")), None)
    if header is None:
        return Offer(base=name)
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", header.read_text(errors="replace"), flags=re.S)
    start = re.search(rf"^class\s+(?:\w+\s+)?{name}\s*:\s*public\s+(\w+)", text, re.M)
    found = offer(folders, start.group(1)) if start.group(1).startswith(("q", "ctk")) else Offer()
    found.base = found.base or start.group(1)
    body = text[start.end() :]
    body = body[: re.search(r"^};", body, re.M).start()]
    found.properties |= set(PROPERTY.findall(body))
    kind = "private"
    for line in re.sub(r"\n[ \t]{4,}", " ", body).splitlines():
        section = SECTION.match(line)
        if section:
            who, slots = section.groups()
            signals = who in ("signals", "Q_SIGNALS")
            kind = "signals" if signals else "slots" if slots and who == "public" else who
            continue
        function = FUNCTION.search(line)
        if function is None or "Q_PROPERTY" in line:
            continue
        if kind in ("signals", "slots"):
            arguments = [re.sub(r"=.*", "", a).strip() for a in function[3].split(",")]
            types = ",".join(_type(argument) for argument in arguments if argument)
            getattr(found, kind).update({function[2], f"{function[2]}({types})"})
        elif "Q_INVOKABLE" in line and kind == "public":
            found.methods.add(function[2])
    return found


def _type(argument: str) -> str:
    """Return the type of an argument, as Qt writes it in a signature, without the name."""
    words = re.match(r"(?:const\s+)?([\w:<>]+\s*[*&]*)\s*\w*$", argument)
    return words[1].replace(" ", "").rstrip("&") if words else argument
