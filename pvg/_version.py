"""The version of the method's distribution."""

__version__ = "0.1.0"
