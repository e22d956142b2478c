# Sourced by the launchers in tools/: makes .venv on first use with pinned versions, sets $python. Expects $here.
python="$here/.venv/bin/python"
pins="$here/tools/requirements.txt"
if [ ! -x "$python" ] || ! cmp -s "$pins" "$here/.venv/installed.txt"; then
  command -v python3 >/dev/null || { echo "python3 is missing: apt-get install python3 python3-venv" >&2; exit 1; }
  python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    { echo "$(python3 --version) is too old: omnibotd needs Python 3.11 or newer (Debian 12 has it)" >&2; exit 1; }
  python3 -c 'import ensurepip, venv' 2>/dev/null ||
    { echo "Python's venv module is missing: apt-get install python3-venv" >&2; exit 1; }
  echo "setting up $here/.venv (first use, about a minute)" >&2
  rm -rf "$here/.venv"
  python3 -m venv "$here/.venv" &&
    "$python" -m pip install --quiet --disable-pip-version-check -r "$pins" &&
    "$python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e "$here" &&
    cp "$pins" "$here/.venv/installed.txt" ||
    { echo "setting up .venv failed: the lines above say why; check the network and the disk, then run this again" >&2; exit 1; }
fi
