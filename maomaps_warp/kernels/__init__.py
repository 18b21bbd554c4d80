"""Warp kernels and functions; public, so that other Warp programs embed them."""
