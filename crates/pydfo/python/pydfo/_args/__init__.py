"""Arguments: numbers, keywords of other tools."""
