"""The version of the method's distribution."""

__version__ = "0.2.0"
