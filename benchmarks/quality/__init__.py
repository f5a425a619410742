"""Quality of the method, measured beside what a user could take instead; see ../README.md."""
