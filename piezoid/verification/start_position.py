"""The references that an axis may be given, and the approach from rest to a first reference."""

from dataclasses import dataclass

import numpy as np

from piezoid.export.parameter_file import AxisParameters
from piezoid.numerics.arrays import Array
from piezoid.verification.loop_plant import rest_position
from piezoid.verification.plant import AxisPlant

_REACH = 0.7  # of the way from the middle of the references to their ends
_LED_s, _STAYED_s = 0.4, 0.2  # nine periods of the slowest loop an outsider's stage got (45 Hz)


@dataclass(frozen=True, kw_only=True)
class ReferenceRange:
    """References that an axis may be given: at most ``farthest_m`` away from ``centre_m``."""

    centre_m: float
    farthest_m: float

    @property
    def radius_m(self) -> float:
        """Radius of paths."""
        return _REACH * self.farthest_m


def reference_range(axis: AxisParameters) -> ReferenceRange:
    """Return the middle of the references of an axis, and how far their ends are from it."""
    low_m, high_m = (float(axis.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    return ReferenceRange(centre_m=0.5 * (low_m + high_m), farthest_m=0.5 * (high_m - low_m))


def approach_path(plant: AxisPlant, begin_m: float) -> Array:
    """Return the reference from rest to the start of a path, and a pause there, (samples,).

    Half a cosine, as a user would approach: the hysteresis of the approach is part of the error,
    the transient of a jump is not.
    """
    rest_m, rate_Hz = rest_position(plant), plant.sampling_rate_Hz
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(_LED_s * rate_Hz)))
    stayed_m = np.full(round(_STAYED_s * rate_Hz), begin_m)
    return np.concatenate([rest_m + (begin_m - rest_m) * share, stayed_m])
