"""Files as laboratories leave them, each with what is wrong and what must come of it."""

from tests.records.messy import characters, clocks, formats, quantities, tables

FILES = (*characters.FILES, *tables.FILES, *clocks.FILES, *formats.FILES, *quantities.FILES)
