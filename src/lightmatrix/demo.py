"""The demo: a simulated capture that clips, four estimates of it, and a report.

A noisy 8-bit camera photographs a pile of white blocks at 32 x 32 under 256 Bernoulli patterns. So
many projector pixels are lit together that samples clip although hardly any single response does.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightmatrix import pictures
from lightmatrix.defaults import USUAL_NOISE
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.estimators.settings import EstimateSettings
from lightmatrix.files.kinds import DEMO
from lightmatrix.files.writing import atomic_folder
from lightmatrix.judgement import metrics
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.pictures.maps import display, white_to_red
from lightmatrix.progress import Progress
from lightmatrix.report.elements import Gallery, Section, Table, image_of_file
from lightmatrix.report.facts import AnyEstimator, Facts, validate
from lightmatrix.report.make import write_page
from lightmatrix.reprs import percent
from lightmatrix.simulation import library
from lightmatrix.simulation.simulate import simulate
from lightmatrix.simulation.truth import binned
from lightmatrix.solvers import ADMM, ROMP, Fidelity, SaturationADMM
from lightmatrix.transport.matrix import LightTransport

SCENE = "l_objects"
PATTERNS = 256
# The exposure puts this quantile of the strongest single responses at the clip level, so that
# samples clip by sums of many responses.
UNCLIPPED_QUANTILE = 0.98
DEFAULT = "lightmatrix"
ESTIMATORS: dict[str, AnyEstimator | EstimateSettings] = {
    "ROMP": PlainEstimator(ROMP(fidelity=Fidelity.LINEAR)),
    "ADMM": PlainEstimator(ADMM()),
    "Saturation ADMM": PlainEstimator(SaturationADMM(Fidelity.CLIPPED)),
    DEFAULT: EstimateSettings(),
}


def demo(
    folder: str | Path, *, overwrite: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Simulate a capture, estimate T by four methods, and write a report of the default one.

    Parameters
    ----------
    folder : str or Path
        The folder to make: report.html, a picture of all methods, demo.json, and the capture.
    overwrite : bool
        Whether an existing report may be replaced.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    dict
        The content of demo.json: the settings, the errors of each method, and, as ``report``,
        the result of `report`.

    Raises
    ------
    OutputError
        If the folder exists or cannot be written.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> result = lm.demo("report")  # doctest: +SKIP
    """
    step = progress or (lambda done, total: None)
    steps = len(ESTIMATORS) + 2
    with atomic_folder(folder, DEMO, overwrite=overwrite) as out:
        truth = binned(library.truth(SCENE), 2)
        known = truth.transport()
        exposure = 1 / float(np.quantile(metrics.row_maximum(known), UNCLIPPED_QUANTILE))
        patterns = BernoulliPatterns(truth.projector_shape, PATTERNS)
        capture = simulate(truth, patterns, exposure=exposure)
        capture.save(out / "capture")
        step(1, steps)
        estimates = {}
        for done, (name, estimator) in enumerate(ESTIMATORS.items(), start=2):
            if isinstance(estimator, EstimateSettings):
                estimator = choose_estimator(capture, estimator)
            estimates[name] = estimator.estimate(capture)
            step(done, steps)
        tests = metrics.unseen_patterns(known.projector_shape)
        shown = np.stack(list(tests.values()))
        result: dict[str, Any] = {
            "scene": SCENE,
            "size": list(truth.camera_shape),
            "patterns": PATTERNS,
            "exposure": exposure,
            "noise": USUAL_NOISE,
            "clipped_samples": capture.raw_clipped_share,
            "clipping_responses": float((metrics.row_maximum(known) * exposure > 1).mean()),
            "methods": [
                {
                    "method": name,
                    "rmse": metrics.response_rmse(
                        one, known, clip_level=1 / exposure, step=2, offset=1
                    ),
                    "relative_error": metrics.relative_error(one, known),
                    "relighting_error": metrics.relighting_error([one], [known], shown),
                }
                for name, one in estimates.items()
            ],
        }
        with pictures.style.figure(8.6, 6.8) as drawing:
            stack = np.stack([capture.frames.read(k) for k in range(PATTERNS)])
            _draw(drawing, stack, known, estimates, tests["disc"], exposure)
            pictures.style.save(drawing, out, "methods")
        validation = validate(capture, EstimateSettings())
        facts = Facts(estimates[DEFAULT], capture, known, validation, truth.geometry)
        result["report"] = write_page(
            out, facts, "Demo: a pile of L-shaped blocks", viewer=True,
            more=[_comparison(result["methods"], out / "methods.png")],
        )  # fmt: skip
        (out / "demo.json").write_text(json.dumps(result, indent=2) + "\n")
        step(steps, steps)
    return result


def _comparison(methods: list[dict[str, Any]], picture: Path) -> Section:
    """The section of the report that compares all methods."""
    rows = tuple(
        (
            method["method"],
            percent(method["relative_error"]),
            percent(method["relighting_error"]),
            f"{method['rmse']:.4f}",
        )
        for method in methods
    )
    heads = ("method", "error of T", "error of relit images", "RMSE of single responses")
    image = image_of_file(
        picture,
        "The scene, a frame with its clipped pixels, and for the truth and each method: a row of "
        "T, an image relit with it, and its error.",
        caption="Clipped pixels are red. Errors: red is too bright, blue too dark.",
    )
    return Section(
        "methods",
        "Four methods on the same photographs",
        "ROMP and ADMM take clipped samples at their value. Saturation ADMM (Chiba and Hashimoto, "
        "BMVC 2018) and lightmatrix, whose estimate this report describes, treat them as clipped.",
        (Table("Errors against the truth, by method", heads, rows), Gallery((image,), "wide")),
    )


def _draw(
    drawing: "pictures.style.Picture",
    stack: NDArray[Any],
    known: LightTransport,
    estimates: Mapping[str, LightTransport],
    pattern: NDArray[np.float32],
    exposure: float,
) -> None:
    """Draw scene and capture, then a row of T and a relit image of the truth and each method."""
    panel, mark_clipped = pictures.style.panel, pictures.style.mark_clipped
    panels = drawing.subplots(4, 1 + len(estimates))
    white = known.relight(np.ones(known.projector_shape, np.float32))
    frame = stack[0] / 255
    panel(panels[0, 0], display(white, float(np.quantile(white, 0.97))), "scene, white light")
    panel(panels[0, 1], display(frame, 1.0), "a frame, 8 bits")
    panel(panels[0, 2], mark_clipped(display(frame, 1.0), stack[0] == 255), "clipped in red")
    often = (stack == 255).mean(axis=0)
    panel(panels[0, 3], often, "share of frames clipped", cmap=white_to_red())
    panel(panels[0, 4], pattern, "unseen pattern")

    # An inner camera pixel that clips in about 40 % of the frames by sums of responses alone.
    rows, cols = often.shape
    quiet = metrics.row_maximum(known).reshape(rows, cols) * exposure < 0.9
    quiet[[*range(rows // 4), *range(rows - rows // 4, rows)]] = False
    quiet[:, [*range(cols // 4), *range(cols - cols // 4, cols)]] = False
    distance = np.where(quiet, np.abs(often - 0.4), np.inf)
    place = [int(k) for k in np.unravel_index(int(np.argmin(distance)), (rows, cols))]
    expected = known.relight(pattern)
    bright = float(np.quantile(expected, 0.98))
    for column, (name, transport) in enumerate({"truth": known, **estimates}.items()):
        row = exposure * transport.row(*place)
        panel(panels[1, column], display(row, float(exposure * known.row(*place).max())), name)
        image = transport.relight(pattern)
        panel(panels[2, column], display(image, bright))
        error = image - expected
        limits: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -0.5, "vmax": 0.5}
        error_panel = panel(panels[3, column], error / bright, **limits)
        if name != "truth":
            off = max(float(np.sqrt(np.mean(error**2))), 1e-12)
            psnr = 20 * np.log10(float(expected.max()) / off)
            panels[2, column].set_xlabel(f"PSNR {psnr:.1f} dB")
    panels[1, 0].set_ylabel(f"row of T, pixel {place[0]}, {place[1]}")
    panels[2, 0].set_ylabel("relit image")
    panels[3, 0].set_ylabel("error of relighting")
    drawing.colorbar(
        error_panel, ax=panels[3, :].tolist(), shrink=0.8, label="error, share of white"
    )
