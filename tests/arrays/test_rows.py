"""Which rows there are."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from candaemon.arrays.rows import distinct


@pytest.mark.parametrize("rows", [[], [3], [2, 2], [5, -1, 5, 0, 7, 0, 5]])
def test_rows_are_returned_once_in_ascending_order(rows: list[int]) -> None:
    found = distinct(np.array(rows, dtype=np.int64))
    assert found.tolist() == sorted(set(rows))
    assert found.dtype == np.int64


def test_no_masked_arrays_are_imported_for_it() -> None:
    code = "import sys, numpy as np; from candaemon.arrays.rows import distinct; distinct(np.array([2, 1, 2])); "
    code += "sys.exit('numpy.ma' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
