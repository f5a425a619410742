"""What a face is: the named points of its landmarks, and its own axes in a picture."""
