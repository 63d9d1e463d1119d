"""Print the table of formats, and what happens to every messy file."""

import sys

from tests.records.messy.outcomes import table
from tests.records.messy.samples import formats_table

sys.stdout.write(f"{formats_table()}\n{table()}")
