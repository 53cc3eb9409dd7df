#!/bin/sh
# Installs starbench into .venv on Debian 12, Debian 13 or Ubuntu 24.04, as root or with sudo:
#   1. LLVM (15 to 19), which compiles the renderer's kernels, and Python's venv module, by apt, where they are missing;
#   2. a virtual environment and starbench with its Python packages, by pip.
# PYTHON=python3.12 chooses the interpreter (3.11 or newer), VENV=DIR the folder. Repeating it does no harm.
set -eu
cd "$(dirname "$0")"
python=${PYTHON:-python3}
venv=${VENV:-.venv}

fail() {
    echo "setup.sh: $1" >&2
    exit 2
}

have() { PATH=$PATH:/sbin:/usr/sbin ldconfig -p 2>/dev/null | grep -q "$1"; }
have_libraries() { have 'libLLVM\(-\|\.so\.\)1[5-9]' && have 'libatomic\.so\.1'; }
have_venv() { "$python" -c 'import ensurepip, venv' 2>/dev/null; }

[ -z "${PYTHON:-}" ] || command -v "$python" >/dev/null || fail "PYTHON = $PYTHON: no such command"
if ! have_libraries || ! have_venv; then
    command -v apt-get >/dev/null || fail "no apt-get here; install LLVM 15 to 19 (its shared library) and Python 3.11 or newer with venv, then repeat"
    sudo=
    if [ "$(id -u)" != 0 ]; then
        sudo=$(command -v sudo) || fail "LLVM 15 to 19 or Python's venv module is missing; run as root, or install sudo"
    fi
    $sudo apt-get update -qq
    llvm=$(apt-cache pkgnames libllvm1 | grep -x 'libllvm1[5-9]\(t64\)\?' | sort -V | tail -n 1)
    [ -n "$llvm" ] || fail "apt offers no package libllvm15 to libllvm19; Debian 12, Debian 13 and Ubuntu 24.04 do"
    $sudo apt-get install -y -qq python3-venv libatomic1 "$llvm" >/dev/null
fi
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    fail "$("$python" --version) is too old; PYTHON=NAME chooses another interpreter, 3.11 or newer"
have_venv || fail "$python has no venv module; install it (on Debian and Ubuntu: $(basename "$python")-venv)"
"$python" -m venv "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check .
"$venv/bin/starbench" doctor
