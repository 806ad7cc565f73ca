"""32 photographs of a rendered scene, row by row and with neighbours, in two exposures.

python examples/few_patterns.py
"""

from __future__ import annotations

import numpy as np

from lightmatrix.camera.exposures import of_frames
from lightmatrix.camera.sensor import Sensor
from lightmatrix.capture.capture import Capture
from lightmatrix.estimators.coherent.estimator import CoherentEstimator
from lightmatrix.estimators.plain import PlainEstimator
from lightmatrix.patterns.bits import BernoulliPatterns
from lightmatrix.rig import library
from lightmatrix.rig.simulate import irradiance
from lightmatrix.solvers import ActiveSet
from lightmatrix.transport.metrics import benchmark_exposure, relative_error


def main() -> dict[str, float]:
    """Estimate T three times and return the relative errors over all rows."""
    truth = library.truth("gripper")  # 64 x 64, comes with the package
    known = truth.transport()
    patterns = BernoulliPatterns(truth.projector_shape, 32)
    light = irradiance(truth.matrix, patterns)

    # At this exposure a fifth of the single responses clip: those cannot be had back. Every
    # fourth frame at a quarter of it brings them in.
    exposure = benchmark_exposure(known)
    mixed = of_frames([(exposure, 0.75), (exposure / 4, 0.25)], patterns)

    def photographed(exposures: float | np.ndarray) -> Capture:
        sensor = Sensor(exposures, 0.0, 0.003, 0.0, 8)
        frames = np.ascontiguousarray(sensor.expose(light).T)
        return Capture.from_arrays(patterns, frames.reshape(-1, *truth.camera_shape), sensor)

    one, two = photographed(exposure), photographed(mixed)
    errors = {
        "row by row": relative_error(PlainEstimator(ActiveSet()).estimate(one), known),
        "coherent": relative_error(CoherentEstimator().estimate(one), known),
        "coherent, two exposures": relative_error(CoherentEstimator().estimate(two), known),
    }
    for name, error in errors.items():
        print(f"{name:24s} relative error {error:.3f}")
    return errors


if __name__ == "__main__":
    main()
