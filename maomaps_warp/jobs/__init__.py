"""The jobs beside scoring, one file each: order, timing, progress; no mathematics, no parsing."""
