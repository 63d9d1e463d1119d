"""A rough surface under the tip: smooth, with a given roughness and shortest wavelength."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array

_WAVES = 40


@dataclass(frozen=True, kw_only=True)
class RoughSurface:
    """A sum of plane waves of random direction, equal height and wavelengths over a decade.

    rms_m       roughness, > 0
    shortest_m  wavelength, > 0; the longest is ten times that
    seed        which surface
    """

    rms_m: float
    shortest_m: float
    seed: int = 0

    def height(self, x_m: Array, y_m: Array) -> Array:
        """Return the height at each point, (samples,) m; 0 at the origin."""
        rng = np.random.default_rng(self.seed)
        wavelength = self.shortest_m * 10.0 ** rng.uniform(0.0, 1.0, _WAVES)
        direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
        found = np.zeros_like(x_m)
        for w, d, p in zip(2.0 * np.pi / wavelength, direction, phase, strict=True):
            found += np.cos(w * (x_m * np.cos(d) + y_m * np.sin(d)) + p) - np.cos(p)
        return np.asarray(self.rms_m * np.sqrt(2.0 / _WAVES) * found)
