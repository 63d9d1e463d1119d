"""Ten million random steps with hostile inputs under address and undefined-behaviour sanitisers.

    python -m benchmarks.hostile_steps [STEPS]

NaN, infinities, denormals, arbitrary bits, stuck readings and gain schedules go through every
method in both precisions; then bytes of the parameters are broken, and whatever ``pz_check`` still
accepts runs as well. STEPS is the sum over the four sets of parameters, for each precision.
"""

import sys
import tempfile
import time
from pathlib import Path

from tests.runtime.compiler import PRECISION
from tests.runtime.hostile import SETS, hostile_steps

STEPS = 10_000_000


def main() -> None:
    """Run and print; anything wrong ends with an error."""
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else STEPS
    each = -(-steps // len(SETS))
    for precision in PRECISION:
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            said = hostile_steps(precision, Path(folder), each)
        lines = said.splitlines()
        accepted = sum(int(line.split()[-1]) for line in lines if "accepted" in line)
        print(
            f"{precision}: {each * len(SETS)} steps, no fault, no output outside its limits; "
            f"{4000 * len(SETS)} broken parameter sets, {accepted} accepted and run; "
            f"{time.perf_counter() - began:.0f} s"
        )
        print("\n".join(f"  {line}" for line in lines if "digest" in line))


if __name__ == "__main__":
    main()
