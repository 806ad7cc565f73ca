"""Stored matrices with damaged chunks: only the rows in these are solved again, and put back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lightmatrix.capture.capture import Capture
from lightmatrix.capture.given import given_capture
from lightmatrix.errors import InputError
from lightmatrix.estimators.auto import AutoEstimator
from lightmatrix.estimators.join import complete_with
from lightmatrix.estimators.steps import Progress, Work
from lightmatrix.store import ROWS, Checkpoint
from lightmatrix.store.repair import Damage, differing
from lightmatrix.store.tiles import Span
from lightmatrix.store.zarr_file import look

# Rows are solved again in about so many at a time.
_TOGETHER = 1024


@dataclass(frozen=True)
class Repair:
    """What was done to a stored matrix.

    Parameters
    ----------
    chunks : tuple of str
        Files within the store that were damaged, and are whole again.
    rows : int
        Camera samples that were solved again for it.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> lm.Repair(("data/c/0",), 4096).chunks
    ('data/c/0',)
    """

    chunks: tuple[str, ...]
    rows: int


def repair(
    path: str | Path,
    capture: Capture | str | Path,
    *,
    estimator: AutoEstimator | None = None,
    progress: Progress | None = None,
) -> Repair:
    """Make the damaged chunks of a stored matrix whole, from the capture that it came from.

    The rows that lie in them are solved again and compared with whatever of them is not damaged;
    all that is not damaged stays as it is. Row by row that takes the time of these rows. Of a
    coherent estimate, whose rows depend on their neighbours', all rounds before the last are gone
    and done again, which takes nearly as long as the estimate took.

    Parameters
    ----------
    path : str or Path
        A .zarr folder from `estimate`.
    capture : Capture, str or Path
        What it was estimated from, cropped and binned likewise.
    estimator : AutoEstimator, optional
        With the settings that it was estimated with. None: the default ones.
    progress : callable, optional
        Called with (done, total) rows.

    Returns
    -------
    Repair
        Empty where nothing was damaged.

    Raises
    ------
    InputError
        If there is no store or too little of it, it was made with other settings, or the rows,
        solved again, are others than it has.
    OutputError
        If somebody else is writing it, or the disk fails.
    ClusterError
        As `estimate`.

    Examples
    --------
    >>> import lightmatrix as lm
    >>> from pathlib import Path
    >>> capture = lm.simulate("metal", lm.BernoulliPatterns((64, 64), 32))
    >>> _ = lm.estimate(capture, coherent=False, output="damaged.zarr")
    >>> Path("damaged.zarr/diagnostics/gap/c/0").unlink()
    >>> lm.repair("damaged.zarr", capture, estimator=lm.AutoEstimator(coherent=False))
    Repair(chunks=('diagnostics/gap/c/0',), rows=4096)
    """
    place = Path(path)
    stored = look(place)
    settings = estimator or AutoEstimator()
    taken = given_capture(capture)
    plan = settings.estimator(taken).plan(taken, progress)
    differing(place, stored.provenance, plan.provenance)
    damage = Damage.of(place)
    if not damage.chunks:
        return Repair((), 0)
    with (
        settings.crew(taken) as crew,
        Checkpoint.repairing(place, plan.fingerprint) as running,
    ):
        wanted = list(_tiles(plan.work, damage.rows))
        complete_with(crew, plan.work, running, wanted)
        rows = {span[0]: running.rows(*span) for span in damage.rows}
        try:
            damage.mend(rows, running)
        except InputError:
            # Rows of another capture are of no use to the next attempt.
            running.discard()
            raise
        running.discard()
    return Repair(tuple(damage.names), sum(stop - start for start, stop in wanted))


def _tiles(work: Work, damaged: list[Span]) -> Iterator[Span]:
    """Tiles of the result that have some of the rows."""
    for start, stop in work.ranges(ROWS, max(1, work.capture.rows // _TOGETHER)):
        if any(first < stop and last > start for first, last in damaged):
            yield start, stop
