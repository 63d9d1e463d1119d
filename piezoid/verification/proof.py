"""The same bits from another build: what was compared, and on how many samples."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Proof:
    """One build of the bundle, stepped through the same inputs as the packaged library.

    build                    compiler, flags and precision, or why nothing was built
    is_built                 False: no compiler or emulator here, nothing is said
    samples                  steps compared, of all axes together
    differing                steps whose voltage or status was not the same in every bit
    instructions_per_sample  by axis, mean; empty where they were not counted
    most_instructions        of any sample, by axis, hostile ones included; likewise
    stack_bytes              deepest stack of a step, None where it was not measured
    state_bytes              of one axis, None likewise
    """

    build: str
    is_built: bool
    samples: int = 0
    differing: int = 0
    instructions_per_sample: dict[str, float] | None = None
    most_instructions: dict[str, int] | None = None
    stack_bytes: int | None = None
    state_bytes: int | None = None

    @property
    def passed(self) -> bool:
        """Whether nothing differed; a build that was not made is no failure."""
        return not self.is_built or (self.samples > 0 and self.differing == 0)
