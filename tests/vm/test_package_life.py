"""Installed, upgraded, removed, purged, in a Debian system that does not run: what stays and what goes."""

import pytest
from debian_image import inside, install

pytestmark = [pytest.mark.vm, pytest.mark.timeout(1800)]
UNIT = "lib/systemd/system/omnibotd.service"


def test_maps_and_configuration_outlive_upgrade_removal_and_purging(debian, packages):
    ours = debian / "etc/omnibotd/omnibotd.yaml"
    kept = debian / "var/lib/omnibotd"
    install(debian, packages[0])
    assert inside(debian, "systemctl", "is-enabled", "omnibotd").strip() == "enabled"
    assert "omnibotd" in inside(debian, "id", "omnibotd")
    assert inside(debian, "omnibotd", "--check").startswith("configuration is good")
    kept.mkdir(exist_ok=True)
    (kept / "home.omap").write_bytes(b"a map")
    ours.write_text(ours.read_text() + "# mine\n")
    inside(debian, "systemctl", "disable", "omnibotd")

    install(debian, packages[1])
    assert inside(debian, "dpkg-query", "-W", "-f", "${Version}", "omnibotd").endswith("+next")
    assert ours.read_text().endswith("# mine\n")
    assert "disabled" in inside(debian, "sh", "-c", "systemctl is-enabled omnibotd || true")  # as its owner wanted

    inside(debian, "dpkg", "--remove", "omnibotd")
    assert not (debian / UNIT).exists() and not (debian / "usr/lib/omnibotd").exists()
    assert ours.read_text().endswith("# mine\n")

    said = inside(debian, "dpkg", "--purge", "omnibotd")
    assert "/var/lib/omnibotd" in said
    assert not ours.exists()
    assert (kept / "omnibotd.yaml.removed").read_text().endswith("# mine\n")
    assert (kept / "home.omap").read_bytes() == b"a map"
    inside(debian, "rm", "-r", "/var/lib/omnibotd")
