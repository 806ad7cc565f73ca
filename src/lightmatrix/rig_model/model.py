"""`RigModel`: what a rig did in the course of a capture, and the capture without it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.correction import Correction
from lightmatrix.patterns.pattern_set import ImagePatterns
from lightmatrix.resources.threads import one_blas_thread
from lightmatrix.rig_model.choice import choose_terms
from lightmatrix.rig_model.prediction import INNER, MARGIN, Prediction, displaced, predicted_light
from lightmatrix.rig_model.term import Draft
from lightmatrix.rig_model.terms import TERMS
from lightmatrix.transport.matrix import LightTransport

Array = NDArray[np.float64]

# The entry of a store's provenance that holds what the rig did.
RIG = "rig"


@dataclass(frozen=True, eq=False)
class RigModel:
    """What a rig did in the course of a capture of K frames; made by `fit_rig`.

    Parameters
    ----------
    values : mapping of str to array
        The numbers of each term that is there: (P, K), or (P,) where all frames share them. gain:
        share by which a frame is brighter than the first. ambient: light added, in clip levels at
        exposure 1. shift: camera pixels down and to the right. rows: shares of slow waves along the
        rows. previous: share of the picture before. camera-curve and projector-curve: the
        undeclared gamma less 1. crosstalk: share lost across and down. sharpening,
        camera-sharpening: strength of three rings around a pixel. dynamic-contrast: change of the
        light from black to white. tone-mapping: power of the light around. black: share of the
        black frame that is too much. camera-blur: its standard deviation in camera pixels.
    errors : mapping of str to array
        Their standard errors, of the same shapes.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> patterns = lm.BernoulliPatterns((64, 64), 32)
    >>> capture = lm.simulate("metal", patterns, exposure=0.15, faults={"previous": 0.1})
    >>> model = lm.fit_rig(capture.crop((16, 16), (32, 32)))
    >>> model.names, round(float(model.values["previous"][0]), 2)
    (('previous',), 0.1)
    """

    values: Mapping[str, Array] = field(default_factory=dict)
    errors: Mapping[str, Array] = field(default_factory=dict)
    # The largest share by which a term changed the photographs when it was found.
    largest: float = 0.0
    # Whether moved pictures have detail between their pixels.
    detail: bool = False

    def __repr__(self) -> str:
        return f"RigModel({'; '.join(self.sentences) or 'nothing found'})"

    @property
    def names(self) -> tuple[str, ...]:
        """The terms that are there, by the names that `correct` takes and the user reads."""
        labels = (TERMS[name]().label_of(values) for name, values in self.values.items())
        return tuple(dict.fromkeys(labels))

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the rig did, a sentence for each term, without full stops."""
        return tuple(TERMS[name]().sentence(values) for name, values in self.values.items())

    def as_dict(self) -> dict[str, Any]:
        """Names, numbers and sentences, JSON-ready."""
        return {
            name: {"values": np.round(values, 6).tolist(), "sentence": sentence}
            for (name, values), sentence in zip(self.values.items(), self.sentences, strict=True)
        }

    @classmethod
    def of(cls, transport: LightTransport) -> "RigModel":
        """What was corrected in an estimate, by its provenance, which may hold anything."""
        kept = transport.provenance.get(RIG)
        values = {}
        for name, facts in kept.items() if isinstance(kept, Mapping) else ():
            if name in TERMS and isinstance(facts, Mapping):
                values[name] = np.asarray(facts.get("values"), np.float64)
        return cls(values)

    def refined(
        self,
        capture: Capture,
        sent: Capture,
        transport: LightTransport,
        allowed: Iterable[str] = tuple(TERMS),
    ) -> "RigModel | None":
        """The model with what else it finds in `capture`, which is `sent` without what is known.

        `transport` is T estimated from `capture`. None if nothing else is found.
        """
        terms = [each() for name, each in TERMS.items() if name in allowed]
        # Threads of these small products would only wait for each other.
        with one_blas_thread():
            seen = Prediction.of(capture, sent, transport)
            # What is found by itself would look like others.
            alone = {} if self.values else {each.name: each.found(seen) for each in terms}
            if found := {name: each for name, each in alone.items() if each is not None}:
                return RigModel(found)
            steps, errors, largest = choose_terms(seen, terms, self.values, self.largest)
        if not steps:
            return None
        values = dict(self.values)
        for name, step in steps.items():
            term = TERMS[name]()
            step = term.based(step)
            before = values.get(name, np.zeros_like(step))
            values[name] = term.based(term.added(before, step))
        ordered = {name: values[name] for name in TERMS if name in values}
        return RigModel(ordered, {**self.errors, **errors}, largest)

    def corrected(self, capture: Capture, transport: LightTransport) -> Capture:
        """The capture without what the rig did, by a T that tells how images move."""
        if not self.values:
            return capture
        draft = Draft(capture, np.ones(capture.count), np.zeros(capture.count))
        for name, values in self.values.items():
            term = TERMS[name]()
            term.take_out(values, draft)
        changed = draft.capture
        if draft.patterns:
            # The patterns that the projector really showed.
            images = capture.patterns.images()
            for change in draft.patterns:
                before = [images[max(0, k - 1)][None] for k in range(len(images))]
                shown = [change(*each) for each in zip(images[:, None], before, strict=True)]
                images = np.concatenate(shown, dtype=np.float32)
            changed = replace(changed, patterns=ImagePatterns(np.clip(images, 0, 1)))
        correction = Correction(draft.gain, draft.ambient, draft.profile, None, draft.lag)
        changed = replace(changed, correction=correction)
        if not draft.images and draft.shift is None:
            return changed
        added = _added(changed, transport, draft, self.detail)
        return replace(changed, correction=replace(correction, added=added))


def _added(
    capture: Capture, transport: LightTransport, draft: Draft, detail: bool
) -> NDArray[np.float32]:
    """What samples of the camera have more than they should, (M, K).

    A moved photograph is what T predicts at its place, and what T misses there. The first is known
    where the camera should be, and the second is moved back. So little of a photograph is
    interpolated once T is nearly right.
    """
    rows, cols, channels = *capture.camera_shape[:2], int(np.prod(capture.camera_shape[2:]))
    width, wide = cols * channels, 2 * MARGIN
    right = np.arange(-wide, cols + wide)
    added = np.empty((capture.rows, capture.count), np.float32)
    # Strips of the camera, so that about ten arrays take 16 MiB each and what lies around them.
    height = max(MARGIN, (1 << 22) // (width * capture.count))
    for top in range(0, rows, height):
        stop = min(top + height, rows)
        first, last = max(0, top - wide), min(rows, stop + wide)
        down = np.arange(top - wide, stop + wide)
        # Beyond the camera, pictures go on as they are at its border.
        inside = np.clip(down, first, last - 1) - first, np.clip(right, 0, cols - 1)
        around = np.ix_(np.zeros(1, int), *inside)
        shape = (1, last - first, cols, channels, capture.count)
        near = slice(first * width, last * width)
        samples = capture.samples(near.start, near.stop)
        light = predicted_light(transport, near, capture.patterns).astype(np.float32)
        light = light.reshape(shape)[around]
        exact = (samples.counted & ~samples.clipped).reshape(shape)[around][INNER]
        places = np.stack(np.meshgrid(down, right, indexing="ij"))[:, *INNER[1:]]
        places = (places + 0.5) / np.array([rows, cols])[:, None, None]
        seen: NDArray[Any] = light[INNER] if draft.shift is None else displaced(light, draft.shift)
        for change in draft.images:
            seen = seen + change(light, places)
        # Splines swing below zero beside bright places.
        seen = np.maximum(seen, 0)
        more = seen[INNER] - light[INNER][INNER]
        if draft.shift is not None or draft.back:
            missed = np.where(exact, samples.values.reshape(shape)[around][INNER] - seen, 0)
            shift = np.zeros((2, 1)) if draft.shift is None else draft.shift
            if detail:
                between = _between(light, missed, exact, shift)
                more += between[INNER]
                missed -= exact * between
            back = displaced(missed, -shift)
            for change in draft.back:
                back = back + change(missed, places[:, *INNER[1:]])
            more = more + missed[INNER] - exact[INNER] * back
        added[top * width : stop * width] = more.reshape(-1, capture.count)
    return added


def _between(
    light: NDArray[Any], missed: NDArray[Any], exact: NDArray[np.bool_], shift: Array
) -> NDArray[Any]:
    """What moved samples miss because of detail that lies between the pixels of the camera.

    From a pixel to each neighbour, light may change by another share than that of a spline. As far
    as the four shares explain more than chance, they are believed.
    """
    parts = [
        (np.roll(light, step, axis)[INNER] - light[INNER]) * move.astype(np.float32)
        for axis, move in zip((1, 2), shift, strict=True)
        for step in (-1, 1)
    ]
    part = np.stack(parts) * exact
    matrix = np.einsum("i...k,j...k->...ij", part, part)
    # Where light changes evenly, neighbours cannot be told apart.
    least = 1e-3 * np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] + 1e-9
    side = np.einsum("i...k,...k->...i", part, missed)
    shares = np.linalg.solve(matrix + least * np.eye(4), side[..., None])[..., 0]
    explained = (shares * side).sum(axis=-1)
    left = ((missed**2).sum(axis=-1) - explained) / np.maximum(exact.sum(axis=-1) - 4, 1)
    kept = np.clip(1 - 4 * left / np.maximum(explained, 1e-12), 0, 1)
    return np.asarray(np.einsum("i...k,...i->...k", part, shares * kept[..., None]))
