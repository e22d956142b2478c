"""Pages that only loading touched, in a process of its own: what is given back, and that all works on."""

import json
import subprocess
import sys

from omnibotd.io.library_pages import untouched

PROGRAM = """
import json
import cv2, numpy, scipy.optimize, scipy.spatial
from omnibotd.io import library_pages

def resident():
    lines = open("/proc/self/status").read().splitlines()
    return {name: int(line.split()[1]) for line in lines for name in ("RssFile", "RssAnon") if line.startswith(name)}

before = resident()
library_pages.give_back()
after = resident()
picture = numpy.zeros((64, 64), numpy.uint8)
picture[16:48, 16:48] = 200
decoded = cv2.imdecode(cv2.imencode(".png", picture)[1], cv2.IMREAD_GRAYSCALE)
root = scipy.optimize.brentq(lambda x: x * x - 2.0, 0.0, 2.0)
print(json.dumps({"before": before, "after": after, "same": bool((decoded == picture).all()), "root": root}))
"""
MAPPING = "{range} {rights} 00000000 08:01 {inode} /usr/lib/a.so\nRss: 8 kB\nAnonymous: {own} kB\nSwap: {swapped} kB\n"


def listed(**changed: object) -> str:
    usual = {"range": "1000-3000", "rights": "r-xp", "inode": 7, "own": 0, "swapped": 0}
    return MAPPING.format(**{**usual, **changed})


def test_most_of_what_loading_mapped_is_given_back_and_everything_still_works():
    done = subprocess.run([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, check=True)
    found = json.loads(done.stdout)
    assert found["after"]["RssFile"] < 0.6 * found["before"]["RssFile"]
    assert found["after"]["RssAnon"] > 0.9 * found["before"]["RssAnon"]
    assert found["same"]
    assert abs(found["root"] ** 2 - 2.0) < 1e-9


def test_code_and_constants_are_given_back():
    assert list(untouched(listed() + listed(range="5000-6000", rights="r--p"))) == [(0x1000, 0x3000), (0x5000, 0x6000)]


def test_what_exists_nowhere_else_stays():
    kept = [{"rights": "rw-p"}, {"rights": "r--s"}, {"inode": 0}, {"own": 4}, {"swapped": 4}]
    for changed in kept:
        assert not list(untouched(listed(**changed)))
    assert list(untouched(listed(own=4) + listed(range="5000-6000"))) == [(0x5000, 0x6000)]
