"""What each effect means for who controls the stage: one sentence for each."""

from collections.abc import Mapping

from piezoid.diagnosis.diagnosis import Finding
from piezoid_reports.quantities import significant

CONTROL: Mapping[str, str] = {
    "something_else": "No model of a controller has it. What is in the reading alone the loop "
    "will follow, so find out first whether the stage moves.",
    "creep": "A feedforward alone drifts off after every step; integral action removes it within "
    "its bandwidth, and a creep ladder in the feedforward takes it off from the start.",
    "thermal_drift": "No feedforward can know of it; only a sensor in the loop, or waiting, "
    "helps. Re-zero before long scans.",
    "rate_dependence": "The inverse is right at one speed only; let the observer take the rest, "
    "or identify at the speed that is used.",
    "resonance": "It limits the bandwidth: keep a notch or a template there, and smooth the "
    "corners of triangles.",
    "delay": "It takes phase in proportion to frequency and so bounds the bandwidth; a constant "
    "delay can be taken off the reference.",
    "lag": "It takes phase and gain; declare the filter in lab.toml or let the plant carry it, "
    "or the loop is designed on the wrong plant.",
    "cross_coupling": "Each axis must be told what the other does: feed its drive forward, or the "
    "loop must reject it as a disturbance.",
    "mains_interference": "It is noise to the loop: a controller with gain at its frequency makes "
    "the stage follow the hum. Mend the wiring before the loop is made fast.",
    "sensor_periodic_error": "The loop holds the reading, not the stage: feedback prints this "
    "error onto the motion. Correct the sensor first.",
    "amplifier_saturation": "Beyond the clip the drive does nothing: narrow the range, or the "
    "integrator winds up.",
    "slew_limit": "Fast large ramps arrive late whatever the controller asks: bound the "
    "reference's speed.",
    "gain_change": "The inverse carries a gain that is no longer true; fit again, or keep the "
    "margin for it.",
    "quantisation": "The loop hunts between steps; a finer converter range helps, filters do not.",
    "timestamp_fault": "The clock of the recording is not that of the stage: nothing fast can be "
    "designed from it. Record again.",
    "outliers": "A single false sample kicks the loop; limit the rate of the reading and find the "
    "bad contact.",
    "initial_state": "The first motion after switching on follows another branch: cycle the drive "
    "before it counts.",
    "asymmetry": "A symmetric inverse is wrong by more on one side; dead zones in the model take "
    "it up exactly.",
    "non_congruence": "Minor loops differ with the bias beyond what the inverse knows: keep "
    "feedback for small scans at the ends of the range.",
}


def words(effect: str) -> str:
    """Return an effect's name as it is said."""
    return effect.replace("_", " ")


def size_of(finding: Finding) -> str:
    """Return the one size of a finding, with the interval that its acceptance allows.

    A cause that was accepted is there: an interval of its size that reaches down to zero bounds it
    from above alone, and is told so.
    """
    size = finding.size
    low, high = size.ci95
    if low <= 0.0 < high:
        return f"{significant(size.value)} {size.unit} (95 %: at most {significant(high)})"
    return (
        f"{significant(size.value)} {size.unit} (95 %: {significant(low)} to {significant(high)})"
    )
