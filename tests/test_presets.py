"""Methods by name."""

import subprocess
import sys
from dataclasses import replace

import pytest

from omnibotd import config
from omnibotd.core.errors import MapError
from omnibotd.core.mapping.training import train
from omnibotd.core.thesis.training import train_thesis
from omnibotd.presets import PRESETS, load_trainer, preset_of
from tests.core.thesis.maps import chain


def test_the_configuration_offers_exactly_the_methods_there_are() -> None:
    assert set(config.PRESETS) == set(PRESETS)


def test_a_map_is_used_by_the_method_that_made_it() -> None:
    topo_map = chain([(0, 0), (1, 0)])
    assert preset_of(topo_map) is PRESETS["thesis"]
    assert preset_of(replace(topo_map, method="default")) is PRESETS["default"]
    with pytest.raises(MapError, match=r"'made'.*'telepathy'.*default, thesis"):
        preset_of(replace(topo_map, method="telepathy"))


def test_trainers_are_found_by_name() -> None:
    assert load_trainer("default") is train
    assert load_trainer("thesis") is train_thesis


def test_the_daemon_never_imports_what_only_training_needs() -> None:
    code = "import omnibotd.daemon, sys; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
