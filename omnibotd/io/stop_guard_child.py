"""The other end of omnibotd/io/stop_guard: run as a program, with as little as possible that could go wrong.

It shares the open port with the daemon and holds one end of a socket on which the daemon's set-points beat. Nothing
but the standard library's smallest parts is imported: it must start fast and stay small.
"""

import os
import select
import signal
import sys
import termios

ROLLING, STANDING, READY = b"r", b"s", b"."
SILENCE = 0.3  # s without a beat while the wheels turn: the tick of 0.1 s has failed twice
PATIENCE = 0.5  # s for a line that takes no more


def guard(line: int, heart: int, stand: bytes, leave: bytes) -> None:
    """Until the daemon is gone; a daemon that hangs and comes round again finds its base standing."""
    rolling = False
    while True:
        ready, _, _ = select.select([heart], [], [], SILENCE if rolling else None)
        if not ready:
            speak(line, stand)
            continue
        beats = os.read(heart, 4096)
        if not beats:
            break
        rolling = beats[-1:] == ROLLING
    speak(line, leave)


def speak(line: int, words: bytes) -> None:
    """Before whatever still waits for the line. The daemon may have left half a command: the words allow for that."""
    try:  # noqa: SIM105 (contextlib is not among the smallest parts)
        termios.tcflush(line, termios.TCOFLUSH)
    except (OSError, termios.error):
        pass  # a socket, or a port that is gone
    while words and select.select([], [line], [], PATIENCE)[1]:
        try:
            words = words[os.write(line, words) :]
        except BlockingIOError:
            continue
        except OSError:
            return  # unplugged: nobody can say anything any more


def main() -> None:
    """Arguments: the port's and the socket's descriptors, both words in hexadecimal."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # systemd ends all processes of a service at once: the daemon goes first
    line, heart = int(sys.argv[1]), int(sys.argv[2])
    os.write(heart, READY)
    try:
        guard(line, heart, bytes.fromhex(sys.argv[3]), bytes.fromhex(sys.argv[4]))
    except ConnectionResetError:
        speak(line, bytes.fromhex(sys.argv[4]))  # the daemon died with our word of readiness unread


if __name__ == "__main__":
    main()
