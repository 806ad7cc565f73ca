"""The coherent estimate: camera pixels learn from their neighbours where their light comes from.

Neighbouring camera pixels look at neighbouring projector pixels. So a row need not find its light
alone: its neighbours' rows say where it probably is. With this help 32 patterns do what takes
hundreds row by row. The algorithm is reweighted l1 minimisation (Candes, Wakin & Boyd 2008), with
the weights of a row taken from the rows around it. It runs in rounds (`schedule.py` lists them):

1. **Search.** Every row is solved by itself on all atoms (`RowSolver.everywhere` in
   `row_solver.py`). An atom is a single projector pixel, or a Gaussian spot of one of six sizes,
   since a footprint out of focus is a spot. With few patterns most of these rows are wrong, but
   they are wrong at random. Above about 91 x 91 pixels only every second camera pixel along both
   axes searches, in large frames every fourth to 32nd; the light then grows to the pixels between
   (`CameraGrid` in `neighbourhood.py`).
2. **Correspondence.** Between neighbouring rows the strongest pixel moves by some displacement; the
   commonest one is the true one, however many rows are wrong. It is measured for the whole frame,
   then locally: the Jacobian of the map from camera to projector pixels (`neighbourhood.py`).
3. **Likely atoms.** Each later round moves the neighbours' rows back by the Jacobian and adds them
   up (`Neighbourhood.likely_atoms` in `neighbourhood.py`, in the compiled core). The 250 atoms with
   the largest sums become the candidates of the row. The larger its sum, the lower the penalty of
   an atom: ``2 lambda e / (e + s)``.
4. **Pseudo-samples.** From the third of these rounds on the neighbours' rows also predict samples
   (`Neighbourhood.pseudo_samples`): in place of samples that clip, and under 64 random patterns
   that nobody projected. They count the less, the less the neighbours agree.
5. **Background.** The light that a row receives by way of other surfaces has one coefficient: a
   halo around the atoms of the row (`Backgrounds` in `row_solver.py`). In the last round coarse
   cells of projector pixels join, for light that differs from the halo.
6. **Weighted problem.** `RowSolver.near` solves each row with these candidates, penalties,
   pseudo-samples and backgrounds to a certified duality gap. `rounds.py` goes on to the next
   round, whose neighbourhood windows are narrower, and skips rows that have settled.
7. **Error of each row.** The last round is solved once more without an eighth of the frames. How
   well it predicts these gives the estimated error of each row (`row_errors.py`). Where light grew,
   some rows are also checked against all atoms (`certified_everywhere` there).

`estimator.py` holds the parameters. `docs/coherent.md` gives the mathematics,
`docs/few-patterns.md` the measurements.
"""
