#!/usr/bin/env bash
# Installs optional system packages, which pip cannot install:
# - the LLVM library, version 17 or newer: the renderer compiles its light paths with it;
# - Aravis, which drives GigE and USB3 Vision cameras, and what its Python bindings need to build;
# - X servers without screens, on which the tests of the live rig show their patterns;
# - a Chromium, in which the tests open the report.
# Does nothing if all of them are there.
set -euo pipefail

# Versions of LLVM, the tested one first. The renderer aborts with 15 and 16.
versions="19 20 21 18 17"
live="xvfb xserver-xorg-core xserver-xorg-video-dummy x11-xserver-utils libgl1 libgl1-mesa-dri
      gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config gcc"

usable_llvm() {
    # The renderer refuses libLLVM 14, and aborts with 15 and 16.
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

missing_live() {
    local package
    for package in $live; do
        dpkg-query --show --showformat='${Status}' "$package" 2>/dev/null \
            | grep -q 'install ok installed' || echo "$package"
    done
}

if ! command -v apt-get >/dev/null; then
    if found=$(usable_llvm); then
        echo "system-deps: the renderer can use $found"
    else
        echo "system-deps: no LLVM 17 or newer; install it with your package manager, or set" >&2
        echo "system-deps: DRJIT_LIBLLVM_PATH to its library. Without it nothing can be rendered." >&2
    fi
    echo "system-deps: no apt-get; docs/devices.md says what cameras and their tests need" >&2
    usable_llvm >/dev/null
    exit
fi

packages=$(missing_live)
browser >/dev/null || packages="$packages chromium"
wants_llvm=
if found=$(usable_llvm); then
    echo "system-deps: the renderer can use $found"
else
    wants_llvm=1
fi
if [ -z "$packages$wants_llvm" ]; then
    echo "system-deps: nothing to do"
    exit 0
fi
as_root=
if [ "$(id -u)" -ne 0 ]; then
    as_root=sudo
fi
$as_root apt-get update -qq
if [ -n "$wants_llvm" ]; then
    package=
    for version in $versions; do
        if apt-cache show "libllvm$version" >/dev/null 2>&1; then
            package=libllvm$version
            break
        fi
    done
    if [ -z "$package" ]; then
        echo "system-deps: apt-get has no libllvm of version $versions; install any from 17 on" >&2
        exit 1
    fi
    packages="$packages $package"
fi
# shellcheck disable=SC2086 # one word a package
echo "system-deps: installing" $packages "with apt-get"
# shellcheck disable=SC2086
$as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get install --yes --no-install-recommends -qq $packages
browser >/dev/null || { echo "system-deps: a Chromium was installed, but not found" >&2; exit 1; }
usable_llvm >/dev/null || { echo "system-deps: an LLVM was installed, but not found" >&2; exit 1; }
echo "system-deps: done"
