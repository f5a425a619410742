"""Training of the network that refines skin masks, `pvg/models/face_skin.onnx`; see the README beside this file."""
