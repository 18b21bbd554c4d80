"""Stages that build maps on the device."""
