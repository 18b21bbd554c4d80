"""Makes synthetic recordings with a known answer."""
