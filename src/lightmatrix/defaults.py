"""Defaults and limits that both the code and the help texts of the command state.

This module imports nothing, so that a help text loads no numerical library.
"""

# Standard deviation of a sample's noise where it is not known, as a share of the clip level: that
# of a decent machine vision camera, about one level of 8 bits. Simulations add as much.
USUAL_NOISE = 0.003
# Exposures of frames and a mix of patterns as users write them.
EXPOSURES_EXAMPLE = "1:0.75,0.25:0.25"
MIX_EXAMPLE = "fine:0.75,32x32:0.125,8x8:0.125"

# The projector size that is assumed if none is stated, rows x columns.
USUAL_SIZE = (128, 128)
# The number of random patterns where none is asked for. Chosen by hand: one for 64 pixels of the
# usual projector.
USUAL_COUNT = 256
# The fewest random patterns that tell pixels apart in black and white, and the fewest that do so at
# all, on small projectors and with grey levels between: 7 err by 0.1 to 0.3 on rendered scenes.
FEWEST_BLACK_AND_WHITE, FEWEST_FRAMES = 16, 8
# The fewest patterns of which a quarter is coarse. Chosen by hand: with fewer, every pattern is
# needed to tell pixels apart.
FEWEST_MIXED = 64

# Patterns that `capture` photographs, and the most where it stops at an accuracy.
USUAL_FRAMES, MOST_FRAMES = 64, 256
# The file that keeps the measurements of a rig.
RIG_FILE = "rig.json"

# The number of patterns up to which rows are estimated with their neighbours by default. With more
# patterns the estimate row by row is good enough, and much faster (docs/few-patterns.md).
COHERENT_UP_TO = 256
# The most passes of the active set solver, and the most iterations of both ADMMs.
PASSES, ADMM_ITERATIONS = 200, 1000

# The scene name that rigs, captures and the command use for procedural scenes.
PROCEDURAL = "procedural"
# Light paths per camera pixel of a rendering: the noise of the entries is a few per cent, and
# rendering takes minutes rather than hours.
USUAL_SAMPLES = 16_384

# The largest matrix that a page relights itself. Beyond it, a browser's tab needs gigabytes.
PAGE_BYTES = 512 << 20
# Endings of video files.
VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")
