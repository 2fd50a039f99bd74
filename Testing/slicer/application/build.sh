#!/usr/bin/env bash
# Builds the application 3D Slicer from its sources, against the libraries of Debian sid.
#
#   build.sh FOLDER [CLONES]     as root; may be run again, and does what is not yet done
#
# FOLDER gets root (a Debian sid), sources and build. CLONES holds git repositories named as in
# sources.txt (Slicer, or Slicer.git, or anything that ends in +Slicer/repo); what it lacks is
# cloned from where sources.txt says. In the environment: JOBS (2), TARGETS (all; SlicerApp-real is
# the program alone), OPT (-O0, the quickest to compile), MIRROR (Debian's, for mmdebstrap).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

stop() { echo "build.sh: $*" >&2; exit 1; }
[ $# -ge 1 ] || stop "say a folder to build in"
[ "$(id -u)" = 0 ] || stop "must be root, for the Debian sid in it"
mkdir -p "$1"/{sources,build}
folder=$(cd "$1" && pwd) clones=${2:-}
root=$folder/root

if [ ! -e "$root/.complete" ]; then
    command -v mmdebstrap > /dev/null || stop "needs mmdebstrap: apt-get install mmdebstrap"
    rm -rf "$root"
    # A mirror that stands still is as good as today's: its date is not asked.
    mmdebstrap --variant=apt --mode=root --include="$(grep -v '^#' "$here/packages.txt" | xargs)" \
        --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='Acquire::Check-Date "false"' \
        --aptopt='Acquire::Languages "none"' sid "$root" ${MIRROR:-}
    touch "$root/.complete"
fi

grep -v '^#' "$here/sources.txt" | while read -r name address commit; do
    copy=$folder/sources/$name
    [ ! -e "$copy/.git" ] || continue
    from=$address
    for place in "$clones/$name" "$clones/$name.git" "$clones"/*+"$name/repo" "$clones"/*+"${name,,}/repo"; do
        [ -z "$clones" ] || [ ! -d "$place" ] || from=$place
    done
    git clone --quiet --no-checkout "$from" "$copy"
    git -C "$copy" checkout --quiet --detach "$commit"
done

exec "$here/enter.sh" "$folder" bash /helpers/configure.sh
