"""Design optimisation of a model."""
