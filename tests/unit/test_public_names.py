"""`import shipgrid`: quick, and complete."""

import subprocess
import sys

import pytest

import shipgrid


def test_importing_the_package_imports_none_of_its_parts():
    code = (
        "import sys, shipgrid\nprint(sorted(m for m in sys.modules if m.startswith(('shipgrid.', 'numpy', 'numba'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_run_starts_without_what_only_a_look_at_its_results_needs():
    late = ("scipy.signal", "xarray", "jinja2")
    code = f"import sys\nfrom shipgrid.scenarios import simulate\nprint([m for m in {late} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_has_one_home_and_is_listed():
    homes = [name for names in shipgrid._HOMES.values() for name in names]
    assert sorted([*homes, "units", "__version__"]) == sorted(shipgrid.__all__)
    assert set(shipgrid.__all__) <= set(dir(shipgrid))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="lod_ship"):
        _ = shipgrid.lod_ship


def test_a_kernel_that_asks_for_what_nobody_hands_it_is_refused_with_what_it_may_ask_for():
    import pytest

    import shipgrid as sg

    def outputs(x, voltage, y):
        y.i = voltage

    with pytest.raises(TypeError) as wrong:
        sg.component(outputs=outputs)
    said = str(wrong.value)
    assert "test_public_names.py" in said and "asks for 'voltage'" in said
    assert "x: states, a record" in said and "x_next" not in said
