#!/usr/bin/env bash
# Creates a folder of Wine for tests: wine_prefix.sh WINE FOLDER. It gets the random numbers that Rust programs need
# (Wine 8.0 has none) and a C compiler, which wine_cc.py runs on this system.
set -euo pipefail
tools=$(cd "$(dirname "$0")" && pwd)
system=$2/drive_c/windows/system32
mkdir -p "$2"
# A program that starts while the server ends, because no other program runs, cannot connect to it.
server=$(dirname "$1")/wineserver
[ ! -x "$server" ] || WINEPREFIX=$2 "$server" -p60
[ -d "$system" ] || WINEPREFIX=$2 WINEDEBUG=-all WINEDLLOVERRIDES=mscoree,mshtml= "$1" cmd /c exit
x86_64-w64-mingw32-gcc -O2 -shared -o "$system/bcryptprimitives.dll" "$tools/bcryptprimitives.c" -ladvapi32
x86_64-w64-mingw32-gcc -O2 -o "$system/cc.exe" "$tools/wine_cc.c" -lws2_32
