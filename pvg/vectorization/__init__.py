"""Algorithm 1, precomputation: a clip becomes an asset, once for all looks."""
