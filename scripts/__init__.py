"""Commands for the Makefile: sample media and the demo."""
