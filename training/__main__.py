"""`python -m training examples --half tune OUT.npz`, then `python -m training fit OUT.npz --onnx NET.onnx`.

With `--net body` examples are of the networks of the body; `fit-cells` fits the one that looks at single cells.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from benchmarks.quality.media import HALVES
from training.example_files import load, save
from training.examples import Maker, body_examples_of, examples_of, of_benchmark, of_packages
from training.pictures import FOLDER
from training.variants import with_variants

_MAKERS: dict[str, Maker] = {"face": examples_of, "body": body_examples_of}


def main() -> None:
    """Make examples or fit the network; see the module and the README."""
    parser = argparse.ArgumentParser(prog="python -m training", description=__doc__)
    what = parser.add_subparsers(dest="what", required=True)
    make = what.add_parser("examples")
    make.add_argument("out", type=Path)
    make.add_argument("--half", choices=(*HALVES, "none"), default="none", help="of the benchmark's labels")
    make.add_argument("--packages", choices=("fit", "test"), help="the pictures in packages, by what they are for")
    make.add_argument("--net", choices=tuple(_MAKERS), default="face", help="of whose box or scene")
    make.add_argument("--variants", type=int, default=0, help="other pictures made of each")
    make.add_argument("--assets", type=Path, default=FOLDER / "assets")
    train = what.add_parser("fit")
    train.add_argument("examples", type=Path, nargs="+")
    train.add_argument("--test", type=Path, nargs="*", default=[])
    train.add_argument("--steps", type=int, default=3000)
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--start", type=Path, help="a network that was fitted before, to go on with")
    train.add_argument("--onnx", type=Path)
    cells = what.add_parser("fit-cells")
    cells.add_argument("examples", type=Path, nargs="+")
    cells.add_argument("--steps", type=int, default=1000)
    cells.add_argument("--seed", type=int, default=0)
    cells.add_argument("--components", type=Path, required=True, help="what brings features to components")
    cells.add_argument("--onnx", type=Path, required=True)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.what == "examples":
        options.assets.mkdir(parents=True, exist_ok=True)
        maker = with_variants(_MAKERS[options.net], options.variants)
        made = [] if options.half == "none" else of_benchmark(options.half, options.assets, maker)
        if options.packages:
            made += of_packages(options.assets, options.packages, maker)
        save(made, options.out)
        return
    from training import cells as of_cells  # noqa: PLC0415 - examples are made without PyTorch
    from training import fitting, network  # noqa: PLC0415

    if options.what == "fit-cells":
        components, of_cell = of_cells.fit_cells(load(options.examples), options.steps, options.seed)
        of_cells.export_components(components, options.components)
        network.export(of_cell, options.onnx, of_cells.CELL_FIELDS)
        return
    net = fitting.fit(load(options.examples), load(options.test), options.steps, options.seed, options.start)
    if options.onnx:
        network.export(net, options.onnx)


if __name__ == "__main__":
    main()
