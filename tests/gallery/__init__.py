"""Made-up faces, scenes, tracks, clips and assets, for all tests: each thing that several tests build, built once."""
