"""A black frame that holds more light than the photographs have without the projector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lightmatrix.rig_model.prediction import Prediction
from lightmatrix.rig_model.term import Array, Draft, Term


class Black(Term):
    """A share of the black frame is too much, (1,): all samples are too small by it.

    If it holds too little light, T takes the rest as diffuse light, which costs little.
    """

    name = "black"
    advice = (
        "take the black frame with the projector showing black, at the exposure of the others and "
        "in the same room light, or state its exposure"
    )

    def found(self, seen: Prediction) -> Array | None:
        """Light is never negative, so what pixels lack where they are dark tells the share."""
        if seen.capture.decoder.black_frame is None:
            return None
        # The light of the black frame is what it takes from the clip level.
        dark = np.mean(1 / seen.capture.exposures - seen.samples.clip_levels_of_all(), axis=1)
        missed = (seen.left**2).sum(axis=1) / np.maximum(seen.free, 1)
        level, scatter = seen.constants
        known = np.flatnonzero((seen.free >= 3) & (scatter > 0))
        if not known.size:
            return None
        # The noise of the black frame is in all samples of a row alike, so it is in the constant.
        weight = (1 / ((scatter + 1) * (missed + np.median(missed))))[known]
        level, dark = level[known], dark[known]
        # Groups of pixels that lie beside each other, since there are dark ones in some. That noise
        # is in `dark` with the opposite sign, so only sums of many pixels are compared.
        most, share = 0.0, 0.0
        for some in np.array_split(np.arange(len(known)), max(1, len(known) // 64)):
            total, light = (weight * dark)[some].sum(), (weight * level)[some].sum()
            off = weight[some] * (level[some] - light / weight[some].sum())
            error = np.sqrt(max(weight[some].sum(), (off**2).sum()))
            if total > 0:
                most, share = min((most, share), ((light + 4 * error) / total, -light / total))
        size = share * np.sqrt((dark**2).mean() / (seen.predicted**2).mean())
        return np.array([min(share, 0.99)]) if most < -0.02 and size > self.least else None

    def take_out(self, values: Array, draft: Draft) -> None:
        decoder = draft.capture.decoder
        stated = decoder.black_exposure or float(np.max(decoder.exposure))
        decoder = replace(decoder, black_exposure=stated / (1 - float(values[0])))
        draft.capture = replace(draft.capture, decoder=decoder)

    def sentence(self, values: Array) -> str:
        more = 100 * values[0] / (1 - values[0])
        return f"the black frame holds {more:.0f} % more light than the room gave the photographs"
