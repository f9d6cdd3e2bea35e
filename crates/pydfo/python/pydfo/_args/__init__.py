"""Arguments: numbers, keywords of other tools, the identity of functions."""
