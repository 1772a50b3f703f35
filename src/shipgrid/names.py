"""Names of ships, scenarios, plant items and signals: the one place that says what they may look like.

A name is shown to people, written into files and made part of the names of folders. So it is never a path, has no
character that a terminal or a file system would take for something else, and is short enough for what is put before
and behind it. The names of plant items are stricter: they are keys of ship files and steps of the paths of signals.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

from shipgrid.errors import ParameterError

LONGEST = 64
"""Most bytes of a name, in UTF-8. File systems allow 255; results are written in `.<scenario>-<fidelity>-xxxxxxxx`."""
LONGEST_PATH = 200
"""Most bytes of the path of a signal. NetCDF allows 255; results append `_mean` and the like."""
ITEM_NAME = re.compile(rf"[a-z][a-z0-9_]{{0,{LONGEST - 1}}}")
"""Name of a plant item, a bus, or what an item gives a name to."""
PART_NAME = re.compile(rf"{ITEM_NAME.pattern}(\.{ITEM_NAME.pattern})*")
"""Name of a part of a plant that is cut: as of a bus, also of one that equipment makes (`genset_for.terminals`)."""
ITEM_EXPECTED = f"expected lower-case letters, digits and _, at most {LONGEST}"
EXPECTED = (
    f"expected letters, digits, spaces and . _ - (a letter or digit first, no two points together), at most {LONGEST}"
)
SHOWN = 40
"""Characters of a name that are shown of one that is refused."""

_WRONG_CHARACTER = re.compile(r"[^\w .-]")
_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def mistake_in(name: str, longest: int = LONGEST) -> str:
    """What keeps a text from being the name of a ship, a scenario or a signal, in words; nothing if it is one.

    Parameters
    ----------
    name : str
    longest : int
        Most bytes in UTF-8.
    """
    wrong = _WRONG_CHARACTER.search(name)
    if not name:
        return "it is empty"
    if wrong:
        return f"it has {wrong[0]!r}"
    if not name[0].isalnum():
        return f"it begins with {name[0]!r}"
    if ".." in name:
        return "it has '..'"
    if name[-1] in " .":
        return f"it ends with {name[-1]!r}"
    if len(name.encode()) > longest:
        return f"it is {len(name.encode())} bytes long"
    return "it is the name of a device on Windows" if _DEVICE.fullmatch(name) else ""


def refusal(name: str) -> str:
    """Why a text cannot be the name of a ship or a scenario, and what is expected; nothing if it can.

    Parameters
    ----------
    name : str
    """
    mistake = mistake_in(name)
    return f"{shown(name)} is not a name: {mistake}, {EXPECTED}" if mistake else ""


def checked(name: str, what: str) -> str:
    """A name, where there is no file to say a line of.

    Parameters
    ----------
    name : str
    what : str
        What it is the name of.

    Raises
    ------
    ParameterError
        If it cannot be one.
    """
    wrong = refusal(name)
    if wrong:
        raise ParameterError(f"{what}: {wrong}")
    return name


def checked_path(path: str, owner: str) -> str:
    """The path of a component or a signal: words with points between them.

    Parameters
    ----------
    path : str
    owner : str
        Name of the network it is in.

    Raises
    ------
    ParameterError
        If it cannot be one.
    """
    mistake = mistake_in(path, LONGEST_PATH)
    if mistake and not _DEVICE.fullmatch(path):  # nothing is called so on a disk
        raise ParameterError(
            f"{owner}: {shown(path)} is not a name: {mistake}, expected letters, digits, spaces and _ -, words joined "
            f"by points, at most {LONGEST_PATH}"
        )
    return path


def shown(name: str) -> str:
    """A text in quotes for a message: cut where it is long, with what is not printable written out."""
    return repr(name if len(name) <= SHOWN else f"{name[:SHOWN]}...")


def similar(word: str, valid: Iterable[str]) -> str:
    """Hint naming the nearest valid word, or nothing.

    Parameters
    ----------
    word : str
        What was given.
    valid : iterable of str
        What could have been meant.
    """
    near = difflib.get_close_matches(word, list(valid), n=1, cutoff=0.5)
    return f" (nearest: '{near[0]}')" if near else ""


def nearest(word: str, valid: Iterable[str]) -> str:
    """Hint naming the nearest valid word, or all of them where there are few, or nothing.

    Parameters
    ----------
    word : str
        What was given.
    valid : iterable of str
        What could have been meant.
    """
    names = list(valid)
    every = f" (there are: {', '.join(names)})" if 0 < len(names) <= 12 else ""
    return similar(word, names) or every
