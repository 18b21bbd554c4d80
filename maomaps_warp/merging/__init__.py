"""Baselines of map merging: to have something real to score, not to be the best."""
