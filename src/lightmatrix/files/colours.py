"""The names of colour channels, in the order of an image's last axis, and folders of stores."""

from pathlib import Path

from lightmatrix.paths import as_path

COLOURS = ("red", "green", "blue")


def stores_within(folder: str | Path) -> tuple[Path, ...]:
    """The stores of the primaries of a colour projector, or of several projectors, in a folder."""
    if holds_colour(folder):
        return colour_paths(folder)
    found = as_path(folder).glob("projector-*.zarr")
    return tuple(sorted(found, key=lambda path: (len(path.name), path.name)))


def shown_files(output: str | Path, count: int) -> list[Path]:
    """The files of so many images: one, or one for each projector, NAME-1.png, NAME-2.png, ..."""
    path = Path(output)
    if count == 1:
        return [path]
    return [path.with_name(f"{path.stem}-{k}{path.suffix}") for k in range(1, count + 1)]


def instead_of(folder: str | Path, hint: str) -> str:
    """The hint on what to give in place of a folder: a store or a capture in it, if it has some."""
    place = as_path(folder)
    if all(any(place.glob(f"{name}*")) for name in ("patterns", "images")):
        return f"it is a capture: `lightmatrix estimate {place}` finds its matrix"
    if (place / "zarr.json").is_file():
        return "it is a store of `estimate`: give the capture that it came from"
    inside = [*place.glob("*.zarr"), *place.glob("camera-[0-9]*")] if place.is_dir() else []
    return f"give one of {', '.join(map(str, sorted(inside)[:4]))}" if inside else hint


def holds_colour(folder: str | Path) -> bool:
    """Whether a path is a folder with a store of each primary."""
    return all(path.is_dir() for path in colour_paths(folder))


def colour_paths(folder: str | Path) -> tuple[Path, Path, Path]:
    """The stores of red, green and blue in a folder."""
    red, green, blue = (as_path(folder) / f"{name}.zarr" for name in COLOURS)
    return red, green, blue
