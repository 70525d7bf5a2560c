"""Runs pytest in a page: `python scripts/run_in_node.py tests/kits/web_pytest.py --rhi-backend web …`."""

from __future__ import annotations

import os
import sys
import tempfile

os.chdir(tempfile.mkdtemp())
os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # plugins of the desk start threads and processes

import pytest  # noqa: E402

OPTIONS = ("-q", "-p", "rhi_pytest", "-p", "no:cacheprovider", "-p", "no:faulthandler", "--capture=sys")

sys.exit(int(pytest.main([*OPTIONS, *sys.argv[1:]])))
