"""The coherent estimate: camera pixels learn from their neighbours where their light comes from.

Rows are reweighted l1 problems (Candes, Wakin & Boyd 2008), with weights from the rows around them.
`docs/coherent.md` explains each step, and `docs/few-patterns.md` has the measurements. The code:
`schedule.py` lists the rounds, and `rounds.py` goes through them. `RowSolver.everywhere` in
`row_solver.py` searches all pixels and spots, `RowSolver.near` solves rows on likely ones.
`neighbourhood.py` has what neighbours say: the Jacobian of the correspondence, likely atoms, and
pseudo-samples. `Backgrounds` in `row_solver.py` has the halo and the coarse cells, `row_errors.py`
the error of each row, `estimator.py` the parameters.
"""
