#!/usr/bin/env bash
# Runs a command in the Debian sid that build.sh has made: enter.sh FOLDER COMMAND [ARGUMENTS...]
#
# There, /src, /build and /helpers are those of FOLDER, /project is this project and /tmp the
# machine's. The mounts live as long as the command.
set -euo pipefail
stop() { echo "enter.sh: $*" >&2; exit 1; }
[ $# -ge 2 ] || stop "say the folder of build.sh and a command"
[ -e "$1/root/.complete" ] || stop "no Debian sid in $1: run build.sh $1"
here=$(cd "$(dirname "$0")" && pwd)
folder=$(cd "$1" && pwd) project=$(cd "$here/../../.." && pwd)
shift
cd "$folder/root"
mkdir -p src build helpers project
touch etc/resolv.conf
export HOME=/build/home
exec unshare --mount bash -euo pipefail -c '
    folder=$1 here=$2 project=$3
    shift 3
    mount --bind "$folder/sources" src
    mount --bind "$folder/build" build
    mount --bind "$here" helpers
    mount --bind "$project" project
    mount --bind /tmp tmp
    mount -t proc proc proc
    mount --rbind /dev dev
    for file in /etc/resolv.conf /etc/hosts /etc/ssl/certs/ca-certificates.crt; do
        [ ! -e "$file" ] || mount --bind "$file" ".$file"
    done
    exec chroot . "$@"' enter.sh "$folder" "$here" "$project" "$@"
