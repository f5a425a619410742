"""Blind comparison: sheets that do not tell whose result is whose, and the score of what viewers chose."""
