#!/usr/bin/env bash
# Installs what lightmatrix can use but Python cannot bring: the LLVM library (17 or newer) through
# which the renderer of the simulated rig compiles. Without it rendering is about a hundred times
# slower, and everything else works as it is. Does nothing where a usable LLVM is found.
set -euo pipefail

package=libllvm19

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
as_root=()
if [ "$(id -u)" -ne 0 ]; then
    as_root=(sudo)
fi
echo "system-deps: installing $package with apt-get"
"${as_root[@]}" apt-get update -qq
if ! "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install --yes --no-install-recommends -qq "$package"; then
    echo "system-deps: apt-get has no $package here; any libllvm from 17 on will do" >&2
    exit 1
fi
usable_llvm >/dev/null || { echo "system-deps: $package installed, but not found" >&2; exit 1; }
echo "system-deps: done"
