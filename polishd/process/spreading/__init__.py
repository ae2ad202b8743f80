"""The effect of any path without a matrix: weights of its blocks on the nodes of a finer grid, and few convolutions."""
