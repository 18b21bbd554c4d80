"""Readers and writers; none of them imports Warp."""
