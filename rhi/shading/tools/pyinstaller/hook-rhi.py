"""PyInstaller's hook for `rhi`: shaders are compiled from their sources, and kernels lie beside the
modules."""

from PyInstaller.utils.hooks import collect_data_files, collect_submodules

_UNUSED = ["conformance/**", "testing/**", "shading/tools/**"]  # of a program that only draws

datas = collect_data_files("rhi", include_py_files=True, excludes=_UNUSED)
hiddenimports = collect_submodules("rhi.backends")
