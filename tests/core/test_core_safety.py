"""The compiled core gives the right result or an ordinary exception, whatever it is called with."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lightmatrix import _core
from tests.helpers.core_arguments import (
    BITS,
    CLIPPED,
    MATRIX,
    MEANS,
    ORDINARY,
    PATTERNS,
    PIXELS,
    RNG,
    ROWS,
    SHOWN,
    SHOWN_SET,
    UNSHOWN,
    VALUES,
    cells,
    expected,
    frames,
    likely,
    neighbourhood,
    pseudo_samples,
    samples,
    settings,
    solve,
    sparse_rows,
    start,
    weighted,
)

ROOT = Path(__file__).parents[2]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a Python process of its own."""
    command = [sys.executable, "-W", "ignore", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=300
    )


def test_valid_arguments_give_results() -> None:
    assert solve(start=start(), progress=lambda done, rows: None).converged.all()
    solved, shares = weighted(
        cells=cells(),
        start=start(),
        expected=None,
        background=np.full((ROWS, PATTERNS), 0.5, np.float32),
    )
    assert solved.converged.all()
    assert shares.shape == (ROWS, 2)
    assert weighted(expected=(UNSHOWN, pseudo_samples()))[0].converged.all()
    assert np.isfinite(expected()[0]).all()
    assert likely()[0][-1] > 0


def test_empty_arguments_give_empty_results() -> None:
    none = samples(values=VALUES[:0], clipped=CLIPPED[:0])
    assert len(solve(samples=none).gap) == 0
    assert _core.bits_forward(BITS, PIXELS, np.zeros((0, PIXELS))).shape == (0, PATTERNS)
    assert _core.bits_adjoint(BITS[:0], PIXELS, np.zeros((2, 0))).tolist() == [[0] * PIXELS] * 2
    assert _core.hadamard(np.zeros((0, 8))).shape == (0, 8)
    assert likely(range=(3, 3), doubts=np.zeros(0))[0].tolist() == [0]


def layouts(values: NDArray[Any]) -> list[NDArray[Any]]:
    """The same values in other memory layouts: Fortran order, strides, backwards, unaligned."""
    spread = np.zeros([2 * side for side in values.shape], values.dtype)
    every_other = spread[tuple(slice(None, None, 2) for _ in values.shape)]
    every_other[...] = values
    backwards = np.ascontiguousarray(values[::-1])[::-1]
    raw = np.zeros(values.nbytes + 1, np.uint8)
    shifted = raw[1:].view(values.dtype).reshape(values.shape)
    shifted[...] = values
    return [np.asfortranarray(values), every_other, backwards, shifted]


def same(one: _core.Solved, other: _core.Solved) -> None:
    for name in ("indptr", "indices", "values", "background", "gap", "passes"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_every_memory_layout_is_read_correctly() -> None:
    weights = RNG.random((ROWS, PATTERNS))
    reference = solve(samples=samples(weights=weights))
    for values, clipped, weight in zip(
        layouts(VALUES), layouts(CLIPPED), layouts(weights), strict=True
    ):
        same(reference, solve(samples=samples(values=values, clipped=clipped, weights=weight)))
    x = RNG.random((5, PIXELS))
    for packed, rows in zip(layouts(BITS), layouts(x), strict=True):
        product = _core.bits_forward(packed, PIXELS, rows)
        np.testing.assert_array_equal(product, _core.bits_forward(BITS, PIXELS, x))
    for rows in layouts(RNG.random((4, 8)).astype(np.float32)):
        np.testing.assert_array_equal(_core.hadamard(rows), _core.hadamard(rows.copy()))
    dense = SHOWN_SET.dense()
    e = RNG.random((2, PATTERNS))
    scores = _core.PreparedPatterns.from_dense(dense, MEANS).scores(e)[0]
    for matrix in layouts(dense):
        again = _core.PreparedPatterns.from_dense(matrix, MEANS).scores(e)[0]
        np.testing.assert_array_equal(again, scores)


def test_integer_width_and_precision_make_no_difference() -> None:
    reference, _ = weighted(start=start(), cells=cells())
    for integer in (np.int32, np.int64):
        for real in (np.float32, np.float64):
            rows = sparse_rows(
                indptr=MATRIX.indptr.astype(integer),
                indices=MATRIX.indices.astype(integer),
                data=MATRIX.data.astype(real),
            )
            same(
                reference,
                weighted(candidates=rows, start=start(coefficients=rows), cells=cells())[0],
            )
            np.testing.assert_array_equal(likely(rows=rows)[1], likely()[1])
            np.testing.assert_array_equal(
                expected(neighbourhood=neighbourhood(rows=start(coefficients=rows)))[0],
                expected()[0],
            )


@given(
    regularization=st.floats(1e-320, 1e308),
    scale=st.sampled_from([0.0, 1e-300, 1e-30, 1.0, 1e30]),
    weight=st.sampled_from([0.0, 1e-38, 1.0, 1e38]),
    fidelity=st.sampled_from(["linear", "one-sided", "rejection"]),
    instructions=st.sampled_from(["portable", "avx2", "avx512", "amx"]),
    signs=st.tuples(st.booleans(), st.booleans()),
    seed=st.integers(0, 2**32 - 1),
)
@hypothesis_settings(max_examples=60, deadline=None)
def test_numbers_of_any_size_give_finite_results(
    regularization: float,
    scale: float,
    weight: float,
    fidelity: str,
    instructions: str,
    signs: tuple[bool, bool],
    seed: int,
) -> None:
    try:
        prepared = SHOWN_SET.prepare(instructions=instructions)
    except ValueError:
        prepared = SHOWN
    rng = np.random.default_rng(seed)
    rows = samples(
        values=rng.normal(size=(ROWS, PATTERNS)) * scale,
        clipped=rng.random((ROWS, PATTERNS)) < 0.3,
        weights=rng.random((ROWS, PATTERNS)) * weight,
    )
    nonnegative, background = signs
    options = settings(
        regularization=regularization,
        fidelity=fidelity,
        nonnegative=nonnegative,
        background=background,
        max_passes=20,
    )
    solved = prepared.solve(rows, options)
    assert np.isfinite(solved.values).all()
    assert np.isfinite(solved.background).all()
    assert solved.indptr[-1] == len(solved.indices)
    if nonnegative:
        assert (solved.values >= 0).all()
        assert (solved.background >= 0).all()


ARRAYS = st.builds(
    lambda shape, dtype, fill, layout: layouts(np.full(shape, fill).astype(dtype))[layout],
    st.lists(st.sampled_from([0, 1, 2, PATTERNS, ROWS, PIXELS]), min_size=1, max_size=3),
    st.sampled_from(["f4", "f8", "i4", "i8", "?", "u1", ">f4", "f2"]),
    st.sampled_from([0.0, 1.0, 0.5, -1.0, 20.0]),
    st.integers(0, 3),
)
ARGUMENTS = st.one_of(ARRAYS, st.none(), st.integers(), st.text(max_size=3), st.just(MATRIX))


@given(values=st.lists(ARGUMENTS, min_size=9, max_size=9))
@hypothesis_settings(max_examples=60, deadline=None)
def test_any_arguments_give_an_ordinary_exception_or_a_result(values: list[Any]) -> None:
    a, b, c, d, e, f, g, h, i = values
    calls: list[Callable[[], Any]] = [
        lambda: _core.bits_forward(a, b, c),
        lambda: _core.bits_adjoint(BITS, PIXELS, a),
        lambda: _core.bits_columns(BITS, PIXELS, a),
        lambda: _core.hadamard(a),
        lambda: _core.rows_times(a, b),
        lambda: _core.PreparedPatterns.from_bits(a, PIXELS, b, c),
        lambda: _core.PreparedPatterns.from_dense(a, b),
        lambda: SHOWN.scores(a),
        lambda: solve(samples=samples(values=a)),
        lambda: solve(samples=samples(values=a, clipped=b, weights=c)),
        lambda: solve(samples=samples(weights=d)),
        lambda: solve(start=start(background=e)),
        lambda: weighted(candidates=SimpleNamespace(indptr=a, indices=b, data=c)),
        lambda: weighted(cells=cells(means=d, penalties=e)),
        lambda: weighted(background=f, start=start(background=g), cells=cells()),
        lambda: expected(neighbourhood=neighbourhood(jacobian=h)),
        lambda: expected(background=i, reach=a),
        lambda: likely(camera=a, projector=b, reach=(c, d), most=e, range=(f, g)),
        lambda: likely(doubts=a),
        lambda: frames(background=a, cells=b, samples=c, pixels=d),
        lambda: frames(wanted=[e, f], out=g, room=h, last_wanted=i),
    ]
    for call in calls:
        with suppress(*ORDINARY):
            call()


LIMITED = """
import resource
import numpy as np
from lightmatrix import _core
from tests.helpers.core_arguments import CLIPPED, SHOWN, VALUES, samples, settings

SHOWN.scores(np.ones((1, 9)))
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + {room}
soft, hard = resource.getrlimit(resource.RLIMIT_AS)
resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
try:
    {call}
except (MemoryError, OSError) as error:
    print(type(error).__name__, error)
# Threads need memory to end, too.
resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sets memory limits as on Linux")
@pytest.mark.parametrize(
    ("room", "call", "message"),
    [
        (
            2**26,
            "_core.bits_forward(np.zeros((2**14, 1), np.uint8), 1, np.zeros((2**12, 1)))",
            "MemoryError not enough memory for the product: 4096 x 16384 numbers",
        ),
        (
            2**28,
            "SHOWN.solve(samples(values=np.tile(VALUES, (60, 1)), "
            "clipped=np.tile(CLIPPED, (60, 1))), settings(threads=700))",
            "MemoryError not enough memory for the threads",
        ),
        (
            2**28,
            "_core.likely_pixels(__import__('scipy.sparse').sparse.csr_array((1, 2**30), "
            "dtype=np.float32), (1, 1, 1), (1, 2**15, 2**15), np.zeros((1, 4), np.float32), "
            "[np.ones(1, np.float32)], 0.1, *[np.ones(1, np.float32)] * 2, (1, 1), 5, "
            "np.ones(1), (0, 1))",
            "MemoryError not enough memory for sums over the pixels",
        ),
    ],
)
def test_missing_memory_is_a_memory_error(room: int, call: str, message: str) -> None:
    script = LIMITED.format(room=room, call=call)
    done = run("-c", script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(message)


NO_THREADS = """
import os
import resource
from tests.helpers.core_arguments import settings, solve

# The limit does not hold for root.
if os.getuid() == 0:
    os.setuid(65534)
resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
try:
    solve(settings=settings(threads=5))
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sets thread limits as on Linux")
def test_threads_that_cannot_start_are_an_error() -> None:
    done = run("-c", NO_THREADS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cannot start 5 threads: ")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_starts_its_own_threads() -> None:
    script = (
        "import os\nfrom tests.helpers.core_arguments import settings, solve\n"
        "solve(settings=settings(threads=None))\nchild = os.fork()\n"
        "solve(settings=settings(threads=None))\n"
        "os._exit(0) if child == 0 else print(os.waitpid(child, 0)[1])"
    )
    done = run("-c", script)
    assert (done.returncode, done.stdout) == (0, "0\n"), done.stderr


def test_an_exception_in_the_progress_callback_stops_the_solver() -> None:
    def stop(done: int, rows: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(progress=stop)
