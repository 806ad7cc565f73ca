"""Pattern sets are linear operators: adjoint identity, dense twin, digests, descriptions."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import lightmatrix as lm
from lightmatrix.capture.samples import Samples
from lightmatrix.errors import InputError
from lightmatrix.files.images import write_image
from lightmatrix.patterns.bits import BernoulliPatterns, BitPatterns, with_white
from lightmatrix.patterns.blocks import BlockPatterns, sampled_pixels
from lightmatrix.patterns.folder import read_patterns, write_patterns
from lightmatrix.patterns.hadamard import HadamardPatterns
from lightmatrix.patterns.making import make_patterns, remake_patterns
from lightmatrix.patterns.mix import MixedPatterns, default_mix, parse_mix
from lightmatrix.patterns.pattern_set import ImagePatterns, PatternSet, grid_cells
from lightmatrix.patterns.stripes import (
    GrayCodePatterns,
    MicroPhasePatterns,
    PhasePatterns,
    stripes_of,
)
from lightmatrix.solvers import ActiveSet
from lightmatrix.solvers.problem import Problem

sizes = st.integers(1, 13)


@st.composite
def pattern_sets(draw: st.DrawFn) -> PatternSet:
    shape = (draw(sizes), draw(sizes))
    seed = draw(st.integers(0, 2**32))
    kinds = ["bernoulli", "hadamard", "blocks", "images", "mix", "bits", "code"]
    kind = draw(st.sampled_from(kinds if max(shape) > 1 else kinds[:-1]))
    if kind == "code":
        inverse, period = draw(st.booleans()), draw(st.floats(4, 9))
        axes = sum(length > 1 for length in shape)
        micro = MicroPhasePatterns(shape, axes * draw(st.integers(5, 7)), period)
        phase = PhasePatterns(shape, period, inverse)
        return draw(st.sampled_from([GrayCodePatterns(shape, inverse), phase, micro]))
    if kind == "bernoulli":
        return BernoulliPatterns(shape, draw(sizes), draw(st.floats(0.01, 0.99)), seed)
    if kind == "mix":
        grid = draw(st.integers(1, shape[0])), draw(st.integers(1, shape[1]))
        mix = ((shape, 1.0),) if grid == shape else ((shape, 0.7), (grid, 0.3))
        return MixedPatterns(shape, draw(sizes), mix, draw(st.floats(0.01, 0.99)), seed)
    if kind == "bits":
        return BernoulliPatterns(shape, draw(sizes), 0.5, seed).subset(np.array([0]))
    if kind == "hadamard":
        order = draw(st.sampled_from(["natural", "sequency", "random"]))
        count = min(draw(sizes), shape[0] * shape[1])
        return HadamardPatterns(shape, count, order, draw(st.booleans()), seed)
    if kind == "blocks":
        return BlockPatterns(shape, (draw(sizes), draw(sizes)))
    generator = np.random.default_rng(seed)
    return ImagePatterns(generator.random((draw(sizes), *shape)).astype(np.float32))


@given(pattern_sets(), st.integers(0, 4), st.sampled_from([np.float32, np.float64]))
@settings(max_examples=150, deadline=None)
def test_products_match_the_dense_matrix_and_are_adjoint(
    patterns: PatternSet, rows: int, dtype: type[np.floating]
) -> None:
    generator = np.random.default_rng(3)
    x = generator.standard_normal((rows, patterns.pixels)).astype(dtype)
    e = generator.standard_normal((rows, patterns.count)).astype(dtype)
    dense = patterns.dense().astype(np.float64)
    assert dense.shape == (patterns.count, patterns.pixels)

    samples, correlations = patterns.forward(x), patterns.adjoint(e)
    assert samples.dtype == correlations.dtype == dtype
    tolerance = 1e-4 if dtype is np.float32 else 1e-10
    np.testing.assert_allclose(samples, x @ dense.T, atol=tolerance)
    np.testing.assert_allclose(correlations, e @ dense, atol=tolerance)
    parts = np.full_like(correlations, np.nan)
    for some, pixels, part in patterns.correlations(e, lambda *part: part):
        parts[some, pixels] = part
    np.testing.assert_allclose(parts, correlations, atol=tolerance)
    np.testing.assert_allclose((samples * e).sum(), (x * correlations).sum(), atol=10 * tolerance)
    np.testing.assert_allclose(patterns.means, dense.mean(axis=1), atol=1e-6)
    np.testing.assert_allclose(patterns.gram, dense @ dense.T, atol=1e-5)


@given(pattern_sets(), st.data())
@settings(max_examples=50, deadline=None)
def test_columns_rows_and_coarse_versions(patterns: PatternSet, data: st.DataObject) -> None:
    dense = patterns.dense()
    index = np.array(data.draw(st.lists(st.integers(0, patterns.pixels - 1), max_size=5)), int)
    np.testing.assert_array_equal(patterns.columns(index), dense[:, index])
    left, right = sorted(data.draw(st.integers(0, patterns.pixels)) for _ in range(2))
    np.testing.assert_array_equal(patterns.span(left, right), dense[:, left:right])
    start = data.draw(st.integers(0, patterns.count))
    np.testing.assert_array_equal(patterns.rows(start, patterns.count), dense[start:])
    block = (data.draw(sizes), data.draw(sizes))
    coarse = patterns.coarse(block)
    for k in range(patterns.count):
        image = patterns.images()[k]
        for i, j in np.ndindex(coarse.shape):
            part = image[i * block[0] : (i + 1) * block[0], j * block[1] : (j + 1) * block[1]]
            assert coarse.images()[k, i, j] == pytest.approx(part.mean(), abs=1e-6)


@given(pattern_sets())
@settings(max_examples=40, deadline=None)
def test_descriptions_remake_the_set(patterns: PatternSet) -> None:
    remade = remake_patterns(json.loads(json.dumps(patterns.description)))
    if isinstance(patterns, ImagePatterns | BitPatterns):
        assert remade is None
    else:
        assert remade is not None
        assert remade.digest == patterns.digest
        np.testing.assert_array_equal(remade.dense(), patterns.dense())


def test_gray_codes_of_neighbours_differ_in_one_bit() -> None:
    bits = GrayCodePatterns((3, 37)).images()[:6, 0]
    assert (np.abs(np.diff(bits, axis=1)).sum(axis=0) == 1).all()
    assert len(np.unique(bits.T, axis=0)) == 37


def test_stripes_are_found_in_their_images() -> None:
    patterns = PhasePatterns((24, 40), inverse=True)
    found = stripes_of(ImagePatterns(patterns.images()))
    assert found is not None
    np.testing.assert_array_equal(found.axes, patterns.stripes.axes)
    for one, other in zip(found.profiles, patterns.stripes.profiles, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
    assert stripes_of(BernoulliPatterns((4, 4), 3)) is None


def test_bernoulli_is_reproducible_and_has_its_density() -> None:
    one = BernoulliPatterns((64, 64), 40, density=0.3, seed=5)
    assert one.digest == BernoulliPatterns((64, 64), 40, density=0.3, seed=5).digest
    assert one.digest != BernoulliPatterns((64, 64), 40, density=0.3, seed=6).digest
    assert one.means.mean() == pytest.approx(0.3, abs=0.005)
    more = BernoulliPatterns((64, 64), 80, density=0.3, seed=5)
    np.testing.assert_array_equal(more.bits[:40], one.bits)


def test_hadamard_is_orthogonal_once_centred() -> None:
    patterns = HadamardPatterns((8, 16), 128, "sequency", permute=True, seed=2)
    signed = 2 * patterns.dense().astype(float) - 1
    np.testing.assert_array_equal(signed @ signed.T, 128 * np.eye(128))


def test_sequency_order_starts_with_low_frequencies() -> None:
    images = HadamardPatterns((8, 8), 64, "sequency").images()
    changes = [
        np.abs(np.diff(image[:, 0])).sum() + np.abs(np.diff(image[0])).sum() for image in images
    ]
    assert images[0].min() == 1
    assert changes == sorted(changes)


def test_hadamard_never_builds_the_matrix() -> None:
    patterns = HadamardPatterns((512, 512), 1024, "random", seed=1)
    e = np.zeros((1, 1024), np.float32)
    e[0, 7] = 1
    np.testing.assert_array_equal(patterns.adjoint(e)[0], patterns.rows(7, 8)[0])


def test_sampled_pixels_are_the_papers_256() -> None:
    index = sampled_pixels((128, 128))
    assert len(index) == 256
    assert index[0] == 4 * 128 + 4


@given(pattern_sets(), st.data())
@settings(max_examples=60, deadline=None)
def test_subsets_are_the_chosen_patterns(patterns: PatternSet, data: st.DataObject) -> None:
    chosen = st.lists(st.integers(0, patterns.count - 1), min_size=1, max_size=6)
    index = np.array(data.draw(chosen))
    subset = patterns.subset(index)
    assert subset.count == len(index)
    np.testing.assert_array_equal(subset.dense(), patterns.dense()[index])
    everything = patterns.subset(np.arange(patterns.count))
    assert everything.digest == patterns.digest


def test_mix_has_its_shares_in_every_prefix_and_its_grids() -> None:
    shape = (96, 64)
    mix = default_mix(shape, 64)
    patterns = MixedPatterns(shape, 64, mix, seed=3)
    for k in range(1, 65):
        counts = np.bincount(patterns.kinds[:k], minlength=3)
        assert np.abs(counts - k * np.array([0.75, 0.125, 0.125])).max() < 1.5
    assert np.bincount(patterns.kinds).tolist() == [48, 8, 8]
    for (grid, _), kind in zip(mix, range(3), strict=True):
        cells = grid_cells(shape, grid)
        first = np.unique(cells, return_index=True)[1]
        block = patterns.dense()[patterns.kinds == kind]
        np.testing.assert_array_equal(block, block[:, first[cells]])
        # Coarse, but not coarser than it says: cells differ from their neighbours.
        assert len(first) == grid[0] * grid[1]
        assert 0.4 < np.abs(np.diff(block[:, first], axis=1)).mean() < 0.6
    fine = BernoulliPatterns(shape, 64, seed=3)
    np.testing.assert_array_equal(
        patterns.bits[patterns.kinds == 0], fine.bits[patterns.kinds == 0]
    )
    longer = MixedPatterns(shape, 100, mix, seed=3)
    np.testing.assert_array_equal(longer.bits[:64], patterns.bits)


def test_default_mix_is_fine_for_few_patterns_and_small_projectors() -> None:
    assert default_mix((128, 128), 32) == (((128, 128), 1.0),)
    assert [grid for grid, _ in default_mix((40, 40), 64)] == [(40, 40), (8, 8)]
    assert default_mix((4, 4), 64) == (((4, 4), 1.0),)
    assert parse_mix("fine:0.75,32x32:0.125,8x8:0.125", (128, 128)) == default_mix((128, 128), 64)
    assert parse_mix("8x8", (16, 16)) == (((8, 8), 1.0),)


def test_the_fast_solver_takes_a_mix_as_bits() -> None:
    mix = MixedPatterns((12, 10), 24, parse_mix("fine:0.5,3x5:0.5", (12, 10)))
    samples = mix.forward(np.eye(1, 120, 7, np.float32))
    problem = Problem(mix, Samples(samples, samples > 9, np.full(24, 9, np.float32)), 0.01)
    solved = ActiveSet().solve(problem)
    assert solved.gap[0] <= 1e-4
    assert solved.coefficients.toarray()[0].argmax() == 7
    bernoulli = BitPatterns((12, 10), mix.bits)
    again = ActiveSet().solve(replace(problem, patterns=bernoulli))
    np.testing.assert_array_equal(again.coefficients.data, solved.coefficients.data)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BernoulliPatterns((0, 4), 3), "both at least 1"),
        (lambda: BernoulliPatterns((4, 4), 0), "0 patterns"),
        (lambda: BernoulliPatterns((4, 4), 3, density=1.0), "density of 1.0"),
        (lambda: HadamardPatterns((4, 4), 17), "there are 16"),
        (lambda: HadamardPatterns((4, 4), 2, "walsh"), "natural, sequency, random"),
        (lambda: BlockPatterns((4, 4), (0, 1)), "block"),
        (lambda: BlockPatterns((4, 4), selected=np.array([16])), "use 0 to 15"),
        (lambda: ImagePatterns(np.full((2, 3, 3), 2.0, np.float32)), r"scale the patterns"),
        (lambda: ImagePatterns(np.zeros((3, 3), np.float32)), r"\(K, rows, cols\)"),
        (lambda: BitPatterns((3, 3), np.zeros((2, 1), np.uint8)), "give .K, 2. bytes"),
        (lambda: MixedPatterns((4, 4), 3, (((4, 5), 1.0),)), "4 x 5 cells on a projector of 4 x 4"),
        (lambda: MixedPatterns((4, 4), 3, (((4, 4), 0.5),)), "sum to 1"),
        (lambda: MixedPatterns((4, 4), 3, ()), "sum to 1"),
        (lambda: MixedPatterns((4, 4), 3, (((4, 4), 0.5), ((4, 4), 0.5))), "one grid twice"),
        (lambda: MixedPatterns((4, 4), 0, (((4, 4), 1.0),)), "0 patterns"),
        (lambda: MixedPatterns((4, 4), 3, (((4, 4), 1.0),), density=0), "density of 0"),
        (lambda: parse_mix("fine:0.5,8x8:0.6", (9, 9)), "sum to 1.1"),
        (lambda: parse_mix("fine:0.5,fine:0.5", (9, 9)), "a name is there twice"),
        (lambda: parse_mix("fine:0.5,8by8:0.5", (9, 9)), "'8by8'"),
        (lambda: parse_mix("fine,8x8", (9, 9)), "for example"),
        (
            lambda: remake_patterns({"kind": "mix", "shape": [4, 4], "count": 2, "mix": [3]}),
            "a mix of .3.",
        ),
        (lambda: GrayCodePatterns((1, 1)), "one above 1"),
        (lambda: PhasePatterns((8, 8), 2.5), "at least 3"),
        (lambda: MicroPhasePatterns((8, 8), 11), "even number from 10 on"),
        (lambda: make_patterns("graycode", (8, 8), 5), "leave the number out: this code has 8"),
        (lambda: remake_patterns({"kind": "bernoulli"}), "cannot be read"),
        (lambda: remake_patterns({"kind": "moire"}), "unknown"),
    ],
)
def test_bad_patterns_are_refused_with_a_remedy(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


@given(st.tuples(sizes, sizes), sizes, st.booleans())
@settings(max_examples=20, deadline=None)
def test_black_and_white_images_are_bits_as_generated_ones_are(
    tmp_path_factory: pytest.TempPathFactory, shape: tuple[int, int], count: int, grey: bool
) -> None:
    made = BernoulliPatterns(shape, count, 0.5, 3)
    folder = tmp_path_factory.mktemp("shown") / "p"
    write_patterns(folder, made)
    (folder / "patterns.json").unlink()
    if grey:
        # One pixel of the last image.
        last = made.images()[-1]
        last[-1, -1] = 0.2
        write_image(sorted(folder.iterdir())[-1], last, overwrite=True)
    read = read_patterns(folder)
    assert isinstance(read, ImagePatterns if grey else BitPatterns)
    if not grey:
        np.testing.assert_array_equal(read.as_bits(), made.bits)
    assert (read.images()[:-1] == made.images()[:-1]).all()
    whiter = with_white(read)
    assert type(whiter) is type(read)
    np.testing.assert_array_equal(whiter.images()[:-1], read.images())
    assert (whiter.images()[-1] == 1).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda shape: BernoulliPatterns(shape, 4),
        lambda shape: make_patterns("mix", shape, 64).subset(np.arange(4)),
        lambda shape: make_patterns("hadamard", shape, 4, permute=True).subset(np.arange(1, 4)),
    ],
    ids=["bernoulli", "mix", "hadamard"],
)
def test_patterns_of_other_shapes_share_nothing(make: Callable[[Any], Any]) -> None:
    """Else those of another size explain photographs, and T is wrong without a finding."""
    first = make((64, 64)).images().reshape(-1, 4096)
    for shape in ((32, 128), (128, 32), (128, 64), (64, 128), (128, 128), (96, 64)):
        other = make(shape).images().reshape(len(first), -1)[:, :4096]
        # Of 4096 independent pixels, half are the same, with a deviation of 0.8 %.
        assert np.abs((first == other).mean(axis=1) - 0.5).max() < 0.05, shape


def test_patterns_of_other_densities_are_not_nested() -> None:
    dark, bright = (BernoulliPatterns((16, 16), 4, density).images() for density in (0.3, 0.6))
    assert (bright[dark == 1] == 0).any()


@pytest.mark.parametrize("order", ["grb", "bgr"])
def test_bit_planes_hold_the_patterns(order: str, tmp_path: Path) -> None:
    patterns = lm.BernoulliPatterns((6, 8), 27, seed=3)
    lm.write_patterns(tmp_path / "p", patterns, bit_planes=order)
    folder = tmp_path / "p" / "bit_planes"
    table = (folder / "sequence.csv").read_text().split()[1:]
    for k, line in enumerate(table):
        number, image, plane, bit = line.split(",")
        assert (int(number), int(plane)) == (k, k % 24)
        planes = np.asarray(Image.open(folder / image))
        shown = planes[..., "RGB".index(bit[0])] >> int(bit[1]) & 1
        assert (shown == patterns.images(k, k + 1)[0]).all()
        assert bit == f"{order[k % 24 // 8].upper()}{k % 8}"
    assert len(table) == 27
    # The bit planes beside them are no patterns.
    assert lm.read_patterns(tmp_path / "p").count == 27


def test_a_capture_in_place_of_its_patterns_is_named(tmp_path: Path) -> None:
    lm.write_patterns(tmp_path / "patterns", lm.BernoulliPatterns((6, 8), 4))
    with pytest.raises(InputError, match=r"is a capture\n.*its patterns are in .*patterns"):
        lm.read_patterns(tmp_path)


@pytest.mark.parametrize(
    ("patterns", "order", "words"),
    [
        (lm.BernoulliPatterns((6, 8), 4), "rgg", "order 'rgg'"),
        (lm.make_patterns("phase", (8, 8)), "grb", "patterns in grey"),
        (lm.colour_bernoulli((8, 8), 4), "grb", "patterns in colour"),
    ],
)
def test_bit_planes_are_refused(
    patterns: lm.PatternSet, order: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(lm.InputError, match=words):
        lm.write_patterns(tmp_path / "p", patterns, bit_planes=order)
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(("count", "levels"), [(8, 4), (10, 3), (16, 2)])
def test_random_patterns_have_levels_by_their_number(count: int, levels: int) -> None:
    patterns = make_patterns("random", (64, 64), count)
    values = patterns.dense()
    expected = np.rint(np.linspace(0, 255, levels)) / 255
    np.testing.assert_array_equal(np.unique(values), expected.astype(np.float32))
    # Each pixel varies, unless patterns are black and white.
    assert levels == 2 or values.std(axis=0).min() > 0.3333
    # As they are projected, they are read back.
    shown = patterns.greys(0, 1) / np.float32(255)
    np.testing.assert_array_equal(shown, patterns.images(0, 1))


def test_levels_are_of_random_patterns_only() -> None:
    with pytest.raises(InputError, match="levels for mix patterns"):
        make_patterns("mix", (8, 8), 4, levels=3)
    assert len(np.unique(make_patterns("random", (8, 8), 40, levels=5).dense())) == 5


@pytest.mark.parametrize(
    "patterns",
    [
        make_patterns("onepixel", (4, 5)),
        make_patterns("onepixel", (4, 5), 12),
        make_patterns("hadamard", (4, 6), 32, permute=True),
        make_patterns("hadamard", (4, 4), 16, order="natural"),
        ImagePatterns(make_patterns("hadamard", (4, 4), 16).images()),
        BernoulliPatterns((4, 4), 300),
    ],
)
def test_samples_of_complete_sets_give_t_and_its_noise(patterns: PatternSet) -> None:
    random = np.random.default_rng(0)
    found = patterns.inverted
    assert found is not None
    lit = found.gains > 0
    t = random.random((3, patterns.pixels)) * lit
    np.testing.assert_allclose(found.solve(patterns.forward(t)), t, atol=1e-5)
    noise = found.solve(random.standard_normal((4000, patterns.count)))
    np.testing.assert_allclose(noise.std(axis=0), found.gains, rtol=0.06)
    assert int(lit.sum()) == min(patterns.count, patterns.pixels)


@pytest.mark.parametrize(
    "patterns",
    [
        BernoulliPatterns((8, 8), 32),
        BernoulliPatterns((4, 4), 256),
        BernoulliPatterns((16, 16), 300),
        make_patterns("hadamard", (4, 4), 15),
        make_patterns("blocks", (8, 8), block=(4, 4)),
    ],
)
def test_other_sets_have_no_inverse(patterns: PatternSet) -> None:
    assert patterns.inverted is None


@given(st.integers(1, 20), st.integers(0, 99))
def test_bits_beyond_the_projector_do_not_count(width: int, seed: int) -> None:
    bits = np.random.default_rng(seed).integers(0, 256, (3, -(-width // 8)), np.uint8)
    patterns = BitPatterns((1, width), bits)
    np.testing.assert_array_equal(patterns.sums, patterns.dense().sum(axis=1))
