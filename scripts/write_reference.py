"""Write the API reference, HTML pages made from the docstrings: `python scripts/write_reference.py [FOLDER]`.

The pages are pdoc's. A warning of pdoc (a name or a type that it can't resolve) is an error here. What docstrings say
of parameters and rules is checked by tests/test_reference.py.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from pathlib import Path
from typing import Final

MODULES: Final = (
    "rhi", "rhi.shading", "rhi.testing", "rhi.testing.portability", "rhi.trace", "rhi.contract", "rhi.backends.null",
    "rhi.conformance",
)  # fmt: skip
"""What users and ports import."""


def write(folder: Path) -> None:
    """Write the pages; `index.html` links them."""
    import pdoc

    for name in MODULES:
        module = importlib.import_module(name)
        for public in getattr(module, "__all__", ()):  # pdoc doesn't see names that are imported on first use
            setattr(module, public, getattr(module, public))
    pdoc.render.configure(docformat="google", show_source=False, footer_text="rhi")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", ".*CommandWork.__init__")  # a NamedTuple's constructor belongs to no module
        # Without the modules inside of them, which aren't for users.
        pdoc.pdoc(*(part for name in MODULES for part in (name, rf"!{name}\.")), output_directory=folder)


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "out/reference")
    write(target)
    print(target / "index.html")
