"""The version of the service, which is that of the distribution it comes in: `pvg` has the same number."""

# of its own, since the service starts without the library
VERSION = "0.2.0"
