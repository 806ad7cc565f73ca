"""A worker that is stopped, and not dead, costs its tiles only."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np
import pytest

import lightmatrix as lm
from lightmatrix.estimators.choice import choose_estimator
from lightmatrix.estimators.workers import pool as pool_module
from lightmatrix.estimators.workers.pool import open_workers

pytest.importorskip("distributed")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not stop processes")
def test_the_tiles_of_a_stopped_worker_go_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "SILENT_TOO_LONG", 5.0)
    truth = lm.ProceduralScene((24, 22), (24, 24)).truth()
    capture = lm.simulate(truth, lm.BernoulliPatterns((24, 24), 48), exposure=0.5)
    settings = lm.EstimateSettings(workers=2, coherent=False)
    estimator, stopped = choose_estimator(capture, settings), list[int]()

    def stop(done: int, total: int) -> None:
        if not stopped and pool is not None:
            stopped.append(next(iter(pool.client.run(os.getpid).values())))
            os.kill(stopped[0], signal.SIGSTOP)

    with open_workers(settings, lm.estimate_resources(capture, settings)) as pool:
        assert pool is not None
        estimate = estimator.estimate(capture, progress=stop, pool=pool)
    assert stopped
    alone = estimator.estimate(capture)
    np.testing.assert_array_equal(estimate.sparse.data, alone.sparse.data)
