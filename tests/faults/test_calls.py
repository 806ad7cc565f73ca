"""Public calls with odd values: a message of this package, never an error of Python or NumPy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightmatrix as lm

SIZE = (8, 8)
PICTURE = np.full(SIZE, 0.5, np.float32)
T = lm.ProceduralScene(SIZE, SIZE, seed=1, bounces=2).truth().transport()
MATCHES = lm.correspondence(T)


def masked(values: Any) -> Any:
    """An array that hides its first column."""
    hidden = np.zeros(np.shape(values), bool)
    hidden[..., 0] = True
    return np.ma.MaskedArray(np.array(values), hidden)


# What takes the place of a number, and of an array.
NUMBERS: tuple[Any, ...] = (
    None,
    "x",
    b"x",
    10**400,
    -(10**400),
    float("nan"),
    [],
    {},
    object(),
    np.zeros(0),
    lm,
)
ARRAYS: tuple[Any, ...] = (
    *NUMBERS,
    masked(PICTURE),
    np.zeros((3, 3), complex),
    np.array("x"),
    [[1], [1, 2]],
)
PATHS: tuple[Any, ...] = (None, 5, b"x")
WHOLE: tuple[Any, ...] = (*NUMBERS, 2.7, np.float64(2.7), 0, -1)
SHAPES: tuple[Any, ...] = (*ARRAYS, 64, (2.7, 1), (0, 8), (10**400, 8), "88", (8,), (8, 8, 8))


def _scene(**changed: Any) -> Any:
    return lm.ProceduralScene(**{"camera_shape": SIZE, "projector_shape": SIZE, **changed})


def _levels(**changed: Any) -> Any:
    return lm.Decoder(**{"clip": 200, "full_scale": 255, **changed})


def _simulated(**changed: Any) -> Any:
    return lm.simulate(lm.truth("metal"), lm.BernoulliPatterns((64, 64), 2), **changed)


def _matches(**changed: Any) -> Any:
    parts = {name: getattr(MATCHES, name) for name in ("pixel", "place", "confidence")}
    return lm.Correspondence(**{**parts, **changed})


# Call with one odd value -> the odd values.
CALLS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...]]] = {
    "make_patterns shape": (lambda v: lm.make_patterns("bernoulli", v, 4), SHAPES),
    "hadamard shape": (lambda v: lm.make_patterns("hadamard", v, 4), SHAPES),
    "blocks shape": (lambda v: lm.make_patterns("blocks", v), SHAPES),
    "mix shape": (lambda v: lm.make_patterns("mix", v, 64), SHAPES),
    "phase shape": (lambda v: lm.make_patterns("phase", v), SHAPES),
    "block": (lambda v: lm.BlockPatterns(SIZE, v), SHAPES),
    "blocks selected": (lambda v: lm.BlockPatterns(SIZE, (4, 4), v), ARRAYS[1:]),
    "make_patterns count": (lambda v: lm.make_patterns("bernoulli", SIZE, v), WHOLE[1:]),
    "hadamard count": (lambda v: lm.make_patterns("hadamard", SIZE, v), WHOLE[1:]),
    "mix count": (lambda v: lm.make_patterns("mix", SIZE, v), WHOLE[1:]),
    "blocks count": (lambda v: lm.make_patterns("blocks", SIZE, v, block=(4, 4)), WHOLE[1:]),
    "microphase count": (lambda v: lm.make_patterns("microphase", SIZE, v), WHOLE[1:]),
    "microphase period": (
        lambda v: lm.make_patterns("microphase", SIZE, period=v),
        NUMBERS[1:],
    ),
    "phase period": (lambda v: lm.make_patterns("phase", SIZE, period=v), NUMBERS[1:]),
    "density": (lambda v: lm.BernoulliPatterns(SIZE, 4, v), NUMBERS),
    "mix": (lambda v: lm.make_patterns("mix", SIZE, 4, mix=v), NUMBERS[1:]),
    "seed": (lambda v: lm.BernoulliPatterns(SIZE, 4, seed=v), (*NUMBERS, 2.7, -1)),
    "colour_bernoulli": (lambda v: lm.colour_bernoulli(SIZE, v), WHOLE),
    "BitPatterns": (lambda v: lm.BitPatterns(SIZE, v), ARRAYS),
    "ImagePatterns": (lm.ImagePatterns, ARRAYS),
    "Response.parse": (lm.Response.parse, (*ARRAYS, "")),
    "clip": (lambda v: _levels(clip=v), (*ARRAYS[1:], 0)),
    "black_level": (lambda v: _levels(black_level=v), ARRAYS[1:]),
    "full_scale": (lambda v: _levels(full_scale=v), NUMBERS[1:]),
    "exposure": (lambda v: _levels(exposure=v), ARRAYS),
    "ReadSettings black": (lambda v: lm.ReadSettings(black=v), (10**400, -1)),
    "ReadSettings clip": (lambda v: lm.ReadSettings(clip=v), ARRAYS[1:]),
    "Sensor clip": (lambda v: lm.Sensor(clip=v), NUMBERS[1:]),
    "Sensor noise": (lambda v: lm.Sensor(read_noise=v), NUMBERS),
    "simulate exposure": (lambda v: _simulated(exposure=v), NUMBERS),
    "simulate black level": (lambda v: _simulated(black_level=v), NUMBERS),
    "simulate leak": (lambda v: _simulated(leak=v), NUMBERS),
    "simulate vignetting": (lambda v: _simulated(vignetting=v), NUMBERS),
    "camera_shape": (lambda v: _scene(camera_shape=v), SHAPES),
    "scene seed": (lambda v: _scene(seed=v), (*NUMBERS, 2.7)),
    "scene bounces": (lambda v: _scene(bounces=v), NUMBERS),
    "camera_response": (lambda v: lm.camera_response(v, [1, 2, 3, 4]), ARRAYS),
    "projector_response": (lm.projector_response, ARRAYS),
    "regularization": (lambda v: lm.EstimateSettings(regularization=v), NUMBERS[1:]),
    "iterations": (lambda v: lm.EstimateSettings(iterations=v), WHOLE[1:]),
    "tile_rows": (lambda v: lm.EstimateSettings(tile_rows=v), WHOLE[1:]),
    "ADMM": (lambda v: lm.ADMM(penalty_x=v), NUMBERS[1:]),
    "ADMM iterations": (lambda v: lm.ADMM(max_iterations=v), WHOLE[1:]),
    "ROMP": (lambda v: lm.ROMP(sparsity=v), WHOLE[1:]),
    "ActiveSet": (lambda v: lm.ActiveSet(max_passes=v), WHOLE[1:]),
    "ActiveSet tolerance": (lambda v: lm.ActiveSet(tolerance=v), NUMBERS),
    "sparse": (lambda v: lm.LightTransport(v, T.background, SIZE, SIZE), ARRAYS),
    "from_matrix": (lambda v: lm.LightTransport.from_matrix(v, SIZE, SIZE), ARRAYS),
    "ColourTransport": (lambda v: lm.ColourTransport(T, v, T), ARRAYS),
    "pixel": (lambda v: _matches(pixel=v), ARRAYS),
    "confidence": (lambda v: _matches(confidence=v), ARRAYS),
    "uncertainty": (lambda v: _matches(uncertainty=v), ARRAYS[1:]),
    "matches' projector": (lambda v: _matches(projector_shape=v), SHAPES[1:]),
    "correspondence": (lm.correspondence, ARRAYS),
    "evaluate_colour": (lambda v: lm.evaluate_colour(v, v), (*ARRAYS, 3)),
    "calibrate_rig": (lm.calibrate_rig, (*ARRAYS, 3)),
    "compensate_video frames": (lambda v: lm.compensate_video(T, v), (*ARRAYS, 3)),
    "estimate": (lm.estimate, PATHS),
    "check": (lm.check, PATHS),
    "open": (lm.open, PATHS),
    "open_colour": (lm.open_colour, PATHS),
    "read_image": (lm.read_image, PATHS),
    "write_image": (lambda v: lm.write_image(v, PICTURE), PATHS),
    "Capture.open": (lm.Capture.open, PATHS),
    "Capture.from_folders": (lambda v: lm.Capture.from_folders(v, v), PATHS),
    "truth": (lm.truth, PATHS),
    "plan": (lm.plan, PATHS),
    "geometry_of": (lambda v: lm.geometry_of(T, v), PATHS[1:]),
    "curve": (lambda v: lm.cancel_global(T, PICTURE, projector_response=v), PATHS[1:]),
    "save path": (lambda v: lm.save(v, T), PATHS),
    "export path": (lambda v: lm.export(v, T), PATHS),
    "save": (lambda v: lm.save("new.zarr", v), ARRAYS),
    "export": (lambda v: lm.export("new.npz", v), ARRAYS),
    "verdicts": (lm.verdicts, ARRAYS),
    "relight matrix": (lambda v: lm.relight(v, PICTURE), ARRAYS[2:]),
    "relight": (lambda v: lm.relight(T, v), ARRAYS[2:]),
    "relight exposure": (lambda v: lm.relight(T, PICTURE, exposure=v), NUMBERS),
    "T.relight": (T.relight, ARRAYS),
    "T.dual": (T.dual, ARRAYS),
    "T @": (lambda v: T @ v, ARRAYS),
    "T.row": (lambda v: T.row(v, 1), (*NUMBERS, 2.7, -1)),
    "T.column": (lambda v: T.column(1, v), (*NUMBERS, 2.7, -1)),
    "compensate": (lambda v: lm.compensate(T, v), ARRAYS[2:]),
    "compensate ambient": (lambda v: lm.compensate(T, PICTURE, ambient=v), ARRAYS[2:]),
    "compensate mask": (lambda v: lm.compensate(T, PICTURE, mask=v), ARRAYS[2:]),
    "compensate gamma": (lambda v: lm.compensate(T, PICTURE, gamma=v), NUMBERS[1:]),
    "compensate_video": (lambda v: lm.compensate_video(T, [v]), ARRAYS[2:]),
    "cancel_global": (lambda v: lm.cancel_global(T, v), ARRAYS[2:]),
    "separate": (lambda v: lm.separate(T, pattern=v), ARRAYS[2:]),
    "plan size": (lambda v: lm.plan("metal", size=v), SHAPES[1:]),
    "plan frames": (lambda v: lm.plan("metal", frames=v), WHOLE[1:]),
    "plan error": (lambda v: lm.plan("metal", error=v), NUMBERS),
    "plan noise": (lambda v: lm.plan("metal", noise=v), NUMBERS),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_odd_values_have_a_message(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, values = CALLS[name]
    for value in values:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with pytest.raises(lm.LightMatrixError) as refusal:
                pytest.fail(f"{value!r:.60} was taken: {call(value)!r:.60}")
        assert len(refusal.value.message) < 1000
    assert not list(tmp_path.iterdir())


def test_endless_views_are_refused_at_once() -> None:
    endless = np.broadcast_to(np.float32(0.5), (1 << 20, 1 << 20))
    for call in (
        T.relight,
        T.dual,
        lambda view: T @ view,
        lambda view: lm.relight(T, view),
        lambda view: lm.compensate(T, view),
        lambda view: lm.separate(T, pattern=view),
    ):
        with pytest.raises(lm.InputError, match="1048576"):
            call(endless)


def test_misspelt_names_are_suggested() -> None:
    with pytest.raises(AttributeError, match="'estmate'; did you mean 'estimate'"):
        _ = lm.estmate  # type: ignore[attr-defined]
    assert not hasattr(lm, "nothing_of_the_kind")
