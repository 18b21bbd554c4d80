"""What `scripts/bench.py` measures: one concern a file.

`flats` makes the scenes, `ours` and `peers_*` are compared, `*_works` measure, `timing` times, `goals` says what is to
be reached, `table` prints and `gate` judges. Nothing of the package imports this.
"""
