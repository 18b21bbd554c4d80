"""`python -m maomaps_warp`."""

from maomaps_warp.cli import main

main()
