"""Print what happens to every messy file."""

import sys

from tests.records.messy.outcomes import table

sys.stdout.write(table())
