"""Algorithm 1, rendering: u' = λI + H(g' − λg) drawn into the planes of a clip."""
