#!/usr/bin/env bash
# Tests the plugin in the ParaViews of later Debians: 5.13 of trixie, 6.1 of forky.
#
#   other_versions.sh [FOLDER] [SUITE...]     as root; may be run again, and does what is not done
#
# FOLDER (build/paraview) gets a minimal Debian per suite (2.7 GB each, made in about ten minutes),
# and pictures of the window in FOLDER/pictures. PYTEST: arguments instead of all of this folder.
# Where no such root can be made it says why and with which command it can, and ends with 77.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
project=$(cd "$here/../.." && pwd)

skip() { echo "other_versions.sh: skipped: $*" >&2; exit 77; }
[ "$(id -u)" = 0 ] || skip "must be root to make a Debian: sudo $0"
command -v mmdebstrap > /dev/null || skip "needs mmdebstrap: apt-get install mmdebstrap"
command -v unshare > /dev/null || skip "needs unshare: apt-get install util-linux"
mkdir -p "${1:-$project/build/paraview}"
folder=$(cd "${1:-$project/build/paraview}" && pwd)
shift || true
[ $# -gt 0 ] || set -- trixie forky

packages=paraview,python3-paraview,python3-scipy,python3-matplotlib,python3-venv,python3-pip
packages+=,openmpi-bin,xvfb,imagemagick,qt6-svg-plugins,libgl1-mesa-dri

inside() { # SUITE COMMAND...: run it in a suite's root, with the project, /tmp and certificates
    local suite=$1 root=$folder/$1
    shift
    mkdir -p "$root/project" "$root/pictures" "$root/etc/ssl/certs" "$folder/pictures/$suite"
    touch "$root/etc/ssl/certs/ca-certificates.crt" "$root/etc/resolv.conf"
    unshare --mount bash -euo pipefail -c '
        cd "$1"
        mount --bind "$2" project
        mount --bind "$3" pictures
        mount --bind /tmp tmp
        mount -t proc proc proc
        mount -t sysfs sys sys
        mount --rbind /dev dev
        for file in /etc/resolv.conf /etc/hosts /etc/ssl/certs/ca-certificates.crt; do
            [ ! -e "$file" ] || [ ! -e ".$file" ] || mount --bind "$file" ".$file"
        done
        shift 3
        exec chroot . env HOME=/root PIP_CERT=/etc/ssl/certs/ca-certificates.crt "$@"
    ' inside "$root" "$project" "$folder/pictures/$suite" "$@"
}

make_root() { # SUITE
    rm -rf "${folder:?}/$1"
    # A mirror that stands still is as good as today's: its date is not asked.
    mmdebstrap --variant=apt --mode=root --include="$packages" \
        --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='Acquire::Check-Date "false"' \
        --aptopt='Acquire::Languages "none"' "$1" "$folder/$1" ${MIRROR:-} \
        || skip "no Debian $1 to be had; with a mirror: MIRROR=http://… $0"
    inside "$1" python3 -m venv --system-site-packages /opt/host
    inside "$1" /opt/host/bin/pip install --quiet itk-elastix SimpleITK "pydicom>=3" pytest \
        pytest-timeout scikit-fem pillow typing_extensions
    # not what reads JPEG-LS, which has no wheel for every Python
    inside "$1" /opt/host/bin/pip install --quiet --no-deps highdicom
    touch "$folder/$1/.complete"
}

failed=0
for suite; do
    [ -e "$folder/$suite/.complete" ] || make_root "$suite"
    inside "$suite" pvserver --version
    inside "$suite" env -u ELASTOIDENTIFY_PYTHON -u ELASTOIDENTIFY_PARAVIEW_SITE \
        PYTHONPATH=/project/ElastoIdentify:/project/Testing PYTHONDONTWRITEBYTECODE=1 \
        OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 LC_ALL=C.UTF-8 \
        ELASTOIDENTIFY_REQUIRE_HOSTS=1 ELASTOIDENTIFY_PICTURES=/pictures \
        bash -c 'cd /project && exec /opt/host/bin/python -m pytest -p no:cacheprovider "$@"' \
        pytest ${PYTEST:-Testing/paraview} || failed=1
done
exit "$failed"
