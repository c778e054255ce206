"""Everything that proposes missions, behind one protocol."""
