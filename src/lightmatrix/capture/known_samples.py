"""A capture whose samples were computed from those of another one."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lightmatrix.camera.decoder import Decoder
from lightmatrix.camera.samples import Samples
from lightmatrix.capture.capture import Capture
from lightmatrix.capture.frames import ArrayStack
from lightmatrix.capture.reader import Reader
from lightmatrix.patterns.pattern_set import PatternSet


@dataclass(frozen=True, eq=False)
class _SampleReader(Reader):
    """Reads samples that are known already."""

    known: Samples = field(kw_only=True)

    def samples(self, start: int, stop: int) -> Samples:
        return self.known.rows(slice(start, min(stop, self.rows)))


@dataclass(frozen=True, eq=False, repr=False)
class KnownSamples(Capture):
    """A capture of samples (M, K) in memory, in place of frames."""

    known: Samples = field(kw_only=True)

    @classmethod
    def of(
        cls, patterns: PatternSet, samples: Samples, camera_shape: tuple[int, ...], exposure: float
    ) -> KnownSamples:
        """Samples of a camera under patterns, in units of the clip level at exposure 1."""
        # Frames of no memory, which nothing reads.
        frames = np.broadcast_to(np.float32(0), (patterns.count, *camera_shape))
        decoder = Decoder(clip=1.0, full_scale=1.0, exposure=exposure)
        return cls(patterns, ArrayStack(frames), decoder, known=samples)

    @cached_property
    def reader(self) -> Reader:
        """The reader of the samples."""
        return _SampleReader(self.frames, self.decoder, None, (1, 1), known=self.known)
