"""What a frame of a video costs at 1,024 x 768: `python -m benchmarks.video [--frames 64]`.

T is made up: a camera of as many pixels as the projector sees it a little turned and blurred, nine
entries a row, and three of light from elsewhere, all told 12, as estimates have; and a background
of 8 x 8 cells. The film pans over a photograph by a pixel a frame.

First, at a sixteenth of the pixels, each frame is compared with hundreds of iterations by itself.
Then come the seconds of each further frame, of the clock and of all cores together, from memory,
from PNG files and from a video to PNG files, and what bounds them: the time to read the bytes of T,
and of one product with it, on one core.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from skimage import data

import lightmatrix as lm
from experiments.harness import best_seconds
from experiments.harness import options as options_of
from lightmatrix.files.images import fitted
from lightmatrix.uses.compensation import compensator

ROWS, COLS = 768, 1024
# Frames of the shorter film, with which the longer one is compared.
FIRST = 32
# Decibels that a frame may lose against hundreds of iterations.
ALLOWED = 1.5


def made_up(rows: int, cols: int) -> lm.LightTransport:
    """T of a textured surface that the camera sees a little turned and blurred."""
    random = np.random.default_rng(0)
    row, col = np.indices((rows, cols), np.float32)
    u, v = 0.97 * col + 0.02 * row, 0.96 * row - 0.02 * col + 0.03 * rows
    middle_u, middle_v = np.rint(u).astype(np.int32), np.rint(v).astype(np.int32)
    albedo = np.kron(random.uniform(0.3, 0.9, (rows // 8, cols // 8)), np.ones((8, 8)))
    columns, values = [], []
    for down, across in np.ndindex(3, 3):
        at_u, at_v = middle_u + across - 1, middle_v + down - 1
        weight = np.exp(-((at_u - u) ** 2 + (at_v - v) ** 2) / (2 * 0.6**2))
        columns.append(at_v.clip(0, rows - 1) * cols + at_u.clip(0, cols - 1))
        values.append(0.3 * albedo * weight)
    for _ in range(3):
        away = random.integers(-40, 41, (2, rows, cols))
        at_u, at_v = cols - 1 - middle_u + away[0], middle_v + away[1]
        columns.append(at_v.clip(0, rows - 1) * cols + at_u.clip(0, cols - 1))
        values.append(0.02 * albedo * random.random((rows, cols)))
    count = rows * cols
    starts = np.arange(0, len(columns) * count + 1, len(columns), dtype=np.int32)
    entries = np.stack(values, -1).astype(np.float32).ravel()
    places = np.stack(columns, -1).astype(np.int32).ravel()
    matrix = csr_array((entries, places, starts), shape=(count, count))
    matrix.sum_duplicates()
    background = np.full((count, 64), 2e-4, np.float32) * albedo.reshape(-1, 1).astype(np.float32)
    known = lm.LightTransport.from_matrix(matrix, (rows, cols), (rows, cols))
    return lm.LightTransport(
        known.sparse, background, (rows, cols), (rows, cols), background_grid=(8, 8)
    )


def film(rows: int, cols: int, frames: int) -> NDArray[np.float32]:
    """Frames (K, rows, cols) of light that pan over a photograph by a pixel each."""
    light = (data.astronaut()[..., 1] / 255.0).astype(np.float32) ** 2.2  # type: ignore[no-untyped-call]
    wide = fitted(light, (rows, cols + frames), "cover")
    return np.stack([wide[:, k : k + cols] for k in range(frames)])


def checked() -> dict[str, float]:
    """What frames lose against hundreds of iterations, in dB; raises if it is too much."""
    rows, cols = ROWS // 4, COLS // 4
    known, wanted = made_up(rows, cols), film(ROWS // 4, COLS // 4, 40)
    video = lm.compensate_video(known, wanted)
    shared, lost = compensator(known), []
    for k in (0, 1, 16, 17, 39):
        best = shared.solve(wanted[k].ravel(), video.brightness, iterations=300)
        own = best.psnr_of(known.relight(video.patterns[k]))
        if abs(own - video.predicted_psnr[k]) > 0.01:
            raise SystemExit(f"frame {k} states {video.predicted_psnr[k]:.2f} dB, has {own:.2f}")
        lost.append(best.psnr - own)
    if max(lost) > ALLOWED:
        raise SystemExit(f"frames lose {max(lost):.2f} dB, {ALLOWED} are allowed")
    return {"best_dB": best.psnr, "lost_dB": max(lost)}


def costs(frames: int) -> dict[str, Any]:
    """Seconds a further frame, in memory and with files, and what bounds them."""
    known, wanted = made_up(ROWS, COLS), film(ROWS, COLS, frames + FIRST)
    arrays = known.sparse.data, known.sparse.indices
    light = wanted[0].ravel()
    found: dict[str, Any] = {
        "entries_per_row": known.sparse.nnz / known.shape[0],
        "megabytes": sum(part.nbytes for part in arrays) / 1e6,
        "reading_s": best_seconds(
            lambda: [part.view(np.uint32).sum(dtype=np.uint32) for part in arrays], 5
        ),
        "product_s": best_seconds(lambda: known.sparse @ light, 5),
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sources: dict[str, Callable[[int], Any]] = {
            "frame": lambda count: wanted[:count],
            "with_png": lambda count: folder / f"frames{count}",
            "with_mp4": lambda count: folder / f"{count}.mp4",
        }
        counts = (FIRST, FIRST + frames)
        for count in counts:
            as_files(wanted[:count], sources["with_png"](count), sources["with_mp4"](count))
        for source, given in sources.items():
            spent = []
            for count in counts:
                output = None if source == "frame" else folder / f"{source}{count}"
                start = np.array([time.perf_counter(), time.process_time()])
                lm.compensate_video(known, given(count), output=output)
                spent.append([time.perf_counter(), time.process_time()] - start)
            a_frame = (spent[1] - spent[0]) / frames
            found[f"{source}_s"], found[f"{source}_core_s"] = map(float, a_frame)
    return found


def as_files(wanted: NDArray[np.float32], pictures: Path, video: Path) -> None:
    """Write the film as PNG files and as an H.264 video."""
    pictures.mkdir()
    with av.open(str(video), "w") as opened:
        stream = opened.add_stream("libx264", rate=30, options={"crf": "18", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = COLS, ROWS, "yuv420p"
        for k, light in enumerate(wanted):
            grey = np.rint(255 * light ** np.float32(1 / 2.2)).astype(np.uint8)
            lm.write_image(pictures / f"{k:04d}.png", grey)
            colours = np.repeat(grey[..., None], 3, axis=2)
            opened.mux(stream.encode(av.VideoFrame.from_ndarray(colours, "rgb24")))
        opened.mux(stream.encode())


def main(arguments: list[str] | None = None) -> None:
    """Compare the frames, then print a line of JSON."""
    parser = options_of("benchmarks.video", __doc__)
    parser.add_argument("--frames", type=int, default=64, help="frames more of the longer film")
    options = parser.parse_args(arguments)
    print(json.dumps(checked()), flush=True)
    print(json.dumps(costs(options.frames)), flush=True)


if __name__ == "__main__":
    main()
