"""The estimated T in pictures: correspondence, white and dual image, background, rows, columns."""

from __future__ import annotations

import numpy as np

from lightmatrix.evaluation.judgement import percent
from lightmatrix.pictures.maps import correspondence_maps, footprint_map, has_diagnostic
from lightmatrix.report.elements import Element, Gallery, Image, Section, Text
from lightmatrix.report.facts import Facts
from lightmatrix.report.image_data import faint_image, image_of_map, photograph


def transport_matrix(facts: Facts) -> Section:
    """Pictures of T, from the geometry to single rows and columns."""
    transport = facts.transport
    captions = (
        "The row of the projector pixel that each camera pixel sees most.",
        "The column of that pixel.",
        "How much of a camera pixel's light comes from that pixel. Dark: the light comes from many "
        "places, by way of other surfaces.",
    )
    maps = correspondence_maps(facts.correspondence)
    images = [image_of_map(*pair) for pair in zip(maps, captions, strict=True)]
    if has_diagnostic(transport, "footprint"):
        caption = "How many projector pixels a camera pixel sees: many where it is out of focus."
        images.append(image_of_map(footprint_map(transport), caption))
    elements: list[Element] = [
        Text(
            "The projector pixel that each camera pixel sees most. `lightmatrix show SCENE.zarr "
            "--correspondence -o map.npz` writes the numbers, to fractions of a pixel."
        ),
        Gallery(tuple(images)),
        Gallery(_views(facts)),
        Text(
            "A row of T shows on the projector where the light of a camera pixel comes from. A "
            "column of T shows in the camera where the light of a projector pixel goes. Faint "
            "light is brightened, so that it is visible beside the bright spot."
        ),
        Gallery(_rows_and_columns(facts)),
    ]
    lead = "How light travels from the projector to the camera, directly and via other surfaces."
    return Section("matrix", "The light transport matrix", lead, tuple(elements))


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
            "The scene with every projector pixel lit, without clipping.",
            exact=True,
        ),
        photograph(
            background,
            f"Light of the background: {share} of all light",
            "Background",
            f"{share} of the light comes faintly from everywhere; shown on the same scale.",
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
    pixels = _example_pixels(facts)
    for why, (row, col) in pixels.items():
        index = (row, col) if len(transport.camera_shape) == 2 else (row, col, 0)
        images.append(
            faint_image(
                transport.row(*index),
                f"Row of T on the projector: camera pixel {row}, {col}",
                f"Row of camera pixel {row}, {col}",
                why,
            )
        )
    for why, (row, col) in pixels.items():
        seen = facts.correspondence.pixel[row, col]
        image = transport.column(int(seen[0]), int(seen[1]))
        images.append(
            faint_image(
                image if image.ndim == 2 else image.mean(axis=2),
                f"Column of T over the camera: projector pixel {seen[0]}, {seen[1]} alone",
                f"Column of projector pixel {seen[0]}, {seen[1]}",
                f"The projector pixel that {why[0].lower()}{why[1:]} sees most.",
            )
        )
    return tuple(images)


def _example_pixels(facts: Facts) -> dict[str, tuple[int, int]]:
    """A few camera pixels that differ from each other, each with its description."""
    matches = facts.correspondence
    white = facts.white if facts.white.ndim == 2 else facts.white.sum(axis=2)
    lit = matches.valid & (white > np.quantile(white, 0.5))
    if not lit.any():
        lit = matches.valid
    if not lit.any():
        return {}
    confidence = np.where(lit, matches.confidence, np.nan)
    middle = float(np.nanmedian(confidence))
    chosen = {
        "A typical bright camera pixel": np.nanargmin(np.abs(confidence - middle)),
        "The bright camera pixel with the most indirect light": np.nanargmin(confidence),
    }
    shares = facts.transport.diagnostics.get("clipped_share")
    if shares is not None and np.any(shares > 0):
        often = np.asarray(shares).reshape(*white.shape, -1).max(axis=2)
        most_clipped = np.argmax(np.where(matches.valid, often, -1))
        chosen["The camera pixel that clipped most often"] = most_clipped
    pixels = {}
    for why, flat in chosen.items():
        row, col = np.unravel_index(int(flat), white.shape)
        pixels[why] = int(row), int(col)
    return pixels
