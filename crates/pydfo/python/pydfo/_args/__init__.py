"""Arguments: checks, conversions and keywords of other tools."""
