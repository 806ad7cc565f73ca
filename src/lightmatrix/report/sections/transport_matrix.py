"""What was found: the geometry, rows and columns of T, background, the view from the projector."""

from __future__ import annotations

import numpy as np

from lightmatrix.evaluation.verdict import percent
from lightmatrix.pictures.maps import correspondence_maps, footprint_map, has_diagnostic
from lightmatrix.report.elements import Block, Gallery, Image, Section, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import faint_image, image_of_map, photograph


def found(facts: Facts) -> Section:
    """Pictures of T, from the geometry to single rows and columns."""
    transport = facts.transport
    captions = (
        "Row of the projector pixel that each camera pixel sees most.",
        "Column of the same pixel.",
        "How much of a camera pixel's light comes from there: dark where it comes from many "
        "places, by way of other surfaces.",
    )
    maps = correspondence_maps(facts.correspondence)
    images = [image_of_map(*pair) for pair in zip(maps, captions, strict=True)]
    if has_diagnostic(transport, "footprint"):
        caption = "How many projector pixels reach a camera pixel: what is out of focus."
        images.append(image_of_map(footprint_map(transport), caption))
    blocks: list[Block] = [
        Text(
            "Which projector pixel each camera pixel sees most. `lightmatrix show SCENE.zarr "
            "--correspondence -o map.npz` gives the numbers, to fractions of a pixel."
        ),
        Gallery(tuple(images)),
        Gallery(_views(facts)),
        Text(
            "Rows of T: where the light of a camera pixel comes from, seen on the projector. "
            "Columns of T: where the light of a projector pixel goes, seen by the camera. Faint "
            "light is raised, so that it is seen beside the bright spot."
        ),
        Gallery(_rows_and_columns(facts)),
    ]
    lead = "T itself: the geometry, light by other paths, and the scene seen from the projector."
    return Section("found", "What was found", lead, tuple(blocks))


def _views(facts: Facts) -> tuple[Image, ...]:
    transport = facts.transport
    rows, cols, *_ = transport.camera_shape
    background = transport.background.sum(axis=1).reshape(transport.camera_shape)
    share = percent(transport.background_share)
    level = float(np.quantile(facts.white, 0.99))
    dual = transport.dual_image()
    return (
        photograph(
            facts.white,
            f"The scene under a white pattern, {rows} x {cols} pixels, computed from T",
            "White pattern",
            "The scene with every projector pixel lit, not clipped.",
            exact=True,
        ),
        photograph(
            background,
            f"Light of the background: {share} of all light",
            "Background",
            f"{share} of the light comes faintly from everywhere; same scale.",
            white=level,
            exact=True,
        ),
        photograph(
            dual,
            "The scene seen from the projector, lit from the camera",
            "Dual image",
            "The scene as the projector would photograph it, lit from the camera.",
            exact=True,
        ),
    )


def _rows_and_columns(facts: Facts) -> tuple[Image, ...]:
    transport = facts.transport
    images = []
    for why, (row, col) in _telling_pixels(facts).items():
        index = (row, col) if len(transport.camera_shape) == 2 else (row, col, 0)
        images.append(
            faint_image(
                transport.row(*index),
                f"Row of T on the projector: camera pixel {row}, {col}",
                f"Row of camera pixel {row}, {col}",
                why,
            )
        )
    for why, (row, col) in _telling_pixels(facts).items():
        seen = facts.correspondence.pixel[row, col]
        image = transport.column(int(seen[0]), int(seen[1]))
        images.append(
            faint_image(
                image if image.ndim == 2 else image.mean(axis=2),
                f"Column of T over the camera: projector pixel {seen[0]}, {seen[1]} alone",
                f"Column of projector pixel {seen[0]}, {seen[1]}",
                f"What the camera sees of the pixel that {why[0].lower()}{why[1:]} sees most.",
            )
        )
    return tuple(images)


def _telling_pixels(facts: Facts) -> dict[str, tuple[int, int]]:
    """A few camera pixels that are unlike each other, by what they are."""
    found = facts.correspondence
    white = facts.white if facts.white.ndim == 2 else facts.white.sum(axis=2)
    lit = found.valid & (white > np.quantile(white, 0.5))
    if not lit.any():
        lit = found.valid
    if not lit.any():
        return {}
    confidence = np.where(lit, found.confidence, np.nan)
    middle = float(np.nanmedian(confidence))
    chosen = {
        "A bright camera pixel like most": np.nanargmin(np.abs(confidence - middle)),
        "The bright camera pixel with most light by other paths": np.nanargmin(confidence),
    }
    shares = facts.transport.diagnostics.get("clipped_share")
    if shares is not None and np.any(shares > 0):
        often = np.asarray(shares).reshape(*white.shape, -1).max(axis=2)
        chosen["The camera pixel that clipped most"] = np.argmax(np.where(found.valid, often, -1))
    places = {}
    for why, flat in chosen.items():
        row, col = np.unravel_index(int(flat), white.shape)
        places[why] = int(row), int(col)
    return places
