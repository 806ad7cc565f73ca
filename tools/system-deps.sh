#!/usr/bin/env bash
# Installs what lightmatrix can use but Python cannot bring: the LLVM library (17 or newer) through
# which the renderer of the simulated rig compiles. Without it rendering is about a hundred times
# slower, and everything else works as it is. Does nothing where a usable LLVM is found.
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

if found=$(usable_llvm); then
    echo "system-deps: $found serves the renderer; nothing to do"
    exit 0
fi
if ! command -v apt-get >/dev/null; then
    echo "system-deps: no LLVM 17 or newer and no apt-get; install LLVM with your package manager," >&2
    echo "system-deps: or set DRJIT_LIBLLVM_PATH to its library. Rendering works without, slowly." >&2
    exit 1
fi
as_root=
if [ "$(id -u)" -ne 0 ]; then
    as_root=sudo
fi
$as_root apt-get update -qq
package=
for version in $versions; do
    if apt-cache show "libllvm$version" >/dev/null 2>&1; then
        package=libllvm$version
        break
    fi
done
if [ -z "$package" ]; then
    echo "system-deps: apt-get has no libllvm of $versions; any from 17 on will do" >&2
    exit 1
fi
echo "system-deps: installing $package with apt-get"
$as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install --yes --no-install-recommends -qq "$package"
usable_llvm >/dev/null || { echo "system-deps: $package installed, but not found" >&2; exit 1; }
echo "system-deps: done"
