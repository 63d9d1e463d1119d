"""All messy files with their faults and expected results."""

from tests.records.messy import characters, clocks, formats, quantities, tables

FILES = (*characters.FILES, *tables.FILES, *clocks.FILES, *formats.FILES, *quantities.FILES)
