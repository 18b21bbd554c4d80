"""Measure how good the maps of visual SLAM are."""
