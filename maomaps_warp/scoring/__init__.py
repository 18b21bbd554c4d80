"""Stages that compare an estimate with the ground truth."""
