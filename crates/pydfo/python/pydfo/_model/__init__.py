"""Models: opening, descriptions, inputs, simulations and their results."""
