"""What lies in a capture folder under a known name: used or not, but never without a word."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

from lightmatrix.capture.description import NAME, Description
from lightmatrix.capture.settings import ReadSettings
from lightmatrix.errors import InputError, LightMatrixWarning
from lightmatrix.files.images import READABLE
from lightmatrix.files.pages import is_stack


def find_images(place: Path, name: str) -> Path:
    """The folder `name` of a capture, or the one file of all its images, such as images.tif.

    Raises
    ------
    InputError
        If there is neither, or more than one.
    """
    folder = place / name
    found = [folder] if folder.is_dir() else []
    found += [
        entry
        for entry in sorted(place.iterdir())
        if entry.stem == name and is_stack(entry) and not entry.is_dir()
    ]
    if not found:
        raise InputError(
            f"{place}: has no folder {name}/",
            hint="give a folder with patterns/ and images/ (or a stack of each, such as "
            "images.tif), or --patterns and --images",
        )
    if len(found) > 1:
        raise InputError(
            f"{place}: holds {found[0].name} and {found[1].name}", hint="keep the one that is meant"
        )
    return found[0]


def check_name(place: Path) -> None:
    """Refuse a folder without a capture.json that has one in other letters, such as Capture.json.

    Raises
    ------
    InputError
        Naming it.
    """
    for entry in sorted(place.iterdir()):
        if entry.name != NAME and entry.name.casefold() == NAME:
            raise InputError(f"{entry}: is not read under this name", hint=f"call it {NAME}")


def with_files_beside(place: Path, description: Description, described: bool) -> ReadSettings:
    """The settings with a black frame or mask that lies in the folder without being named.

    Without capture.json it is used, and with one it is not; a warning says either.

    Raises
    ------
    InputError
        On two files of which either may be meant.
    """
    settings = description.settings
    for key, what in (("black", "the black frame"), ("mask", "the mask")):
        if described and key not in description.absent:
            continue
        files = [
            entry
            for entry in sorted(place.iterdir())
            if entry.stem.lower() == key and entry.suffix.lower() in READABLE
        ]
        if not files:
            continue
        if described:
            message = f"{files[0]}: is not used, since {NAME} does not name it"
            message += f'; add "{key}" to it, or "{key}": null to leave it out'
        elif len(files) > 1:
            raise InputError(
                f"{place}: holds {files[0].name} and {files[1].name}",
                hint=f"keep the one that is {what}",
            )
        else:
            message = f"{files[0]}: is taken for {what}, for want of a {NAME} that says so"
            if key == "black":
                settings = replace(settings, black=files[0])
            else:
                settings = replace(settings, mask=files[0])
        warnings.warn(message, LightMatrixWarning, stacklevel=2)
    return settings
