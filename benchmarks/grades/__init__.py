"""Looks graded one by one, among frames that nobody touched."""
