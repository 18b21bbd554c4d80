"""Proofs about a recording that need no second one: what its poses mean, its depth unit, its stamps."""
