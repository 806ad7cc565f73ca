#!/usr/bin/env bash
# Installs what lightmatrix can use but Python cannot bring:
#   the LLVM library (17 or newer) through which the renderer of the simulated rig compiles; without
#   it rendering is about a hundred times slower, and everything else works as it is;
#   a Chromium, in which the tests look at the report; without it these are skipped.
# Does nothing where both are found.
set -euo pipefail

# The tested one first; never 15 or 16.
versions="19 20 21 18 17"

usable_llvm() {
    # libLLVM 14 is refused by the renderer, 15 and 16 abort it.
    local file version
    for file in /usr/lib/*-linux-gnu/libLLVM* /usr/lib/llvm-*/lib/libLLVM* /usr/lib64/libLLVM*; do
        version=$(basename "$file" | sed -nE 's/^libLLVM[-.](so\.)?([0-9]+).*/\2/p')
        if [ -e "$file" ] && [ "${version:-0}" -ge 17 ]; then
            echo "$file"
            return 0
        fi
    done
    return 1
}

browser() {
    command -v chromium || command -v chromium-browser || command -v google-chrome
}

if found=$(usable_llvm) && browser >/dev/null; then
    echo "system-deps: $found serves the renderer, $(browser) the tests; nothing to do"
    exit 0
fi
if ! command -v apt-get >/dev/null; then
    echo "system-deps: no LLVM 17 or newer or no Chromium, and no apt-get; install them with your" >&2
    echo "system-deps: package manager, or set DRJIT_LIBLLVM_PATH and CHROMIUM to where they are." >&2
    echo "system-deps: Rendering works without LLVM, slowly; tests of the report are skipped." >&2
    exit 1
fi
as_root=
if [ "$(id -u)" -ne 0 ]; then
    as_root=sudo
fi
$as_root apt-get update -qq
packages=
if ! usable_llvm >/dev/null; then
    for version in $versions; do
        if apt-cache show "libllvm$version" >/dev/null 2>&1; then
            packages=libllvm$version
            break
        fi
    done
    if [ -z "$packages" ]; then
        echo "system-deps: apt-get has no libllvm of $versions; any from 17 on will do" >&2
        exit 1
    fi
fi
if ! browser >/dev/null; then
    packages="$packages chromium"
fi
echo "system-deps: installing $packages with apt-get"
# shellcheck disable=SC2086  # several words
$as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install --yes --no-install-recommends -qq $packages
usable_llvm >/dev/null || { echo "system-deps: $packages installed, but no LLVM found" >&2; exit 1; }
browser >/dev/null || { echo "system-deps: $packages installed, but no Chromium found" >&2; exit 1; }
echo "system-deps: done"
