"""Training of the networks that refine skin masks, the `.onnx` files of `pvg/models`; see the README here."""
