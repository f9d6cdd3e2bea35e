"""Runs a command under Wine with a C compiler: `x86_64-w64-mingw32-gcc` of this system, which `wine_cc.exe` calls.

    python tools/wine_cc.py COMMAND ...

Sets WINE_CC_PORT for the command. Paths on the drives C: and Z: of Wine become paths of this system.
"""

import os
import re
import socketserver
import subprocess
import sys
import threading
from pathlib import Path

COMPILER = "x86_64-w64-mingw32-gcc"

#: Options of tests that exist for ELF libraries only.
DROPPED = {"-fPIC", "-Wl,-z,lazy", "-lm", "-Wl,-rpath,$ORIGIN"}


def native(text):
    """Translates paths of Windows in an argument."""
    prefix = Path(os.environ.get("WINEPREFIX") or Path.home() / ".wine")
    drives = {"z": "/", "c": f"{prefix}/drive_c/"}
    text = re.sub(r"(?i)(?:\\\\\?\\)?([cz]):[\\/]", lambda found: drives[found[1].lower()], text)
    return text.replace("\\", "/")


class Compile(socketserver.BaseRequestHandler):
    def handle(self):
        request = b""
        while received := self.request.recv(65536):
            request += received
        folder, *arguments = request.decode().split("\0")[:-1]
        command = [COMPILER, *(native(argument) for argument in arguments if argument not in DROPPED)]
        done = subprocess.run(command, cwd=native(folder), stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.request.sendall(bytes([done.returncode & 127]) + done.stdout)


class Server(socketserver.ThreadingTCPServer):
    request_queue_size = 128
    daemon_threads = True


def main(command):
    with Server(("127.0.0.1", 0), Compile) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        environment = {**os.environ, "WINE_CC_PORT": str(server.server_address[1])}
        sys.exit(subprocess.run(command, env=environment).returncode)


if __name__ == "__main__":
    main(sys.argv[1:])
