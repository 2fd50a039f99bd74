#!/usr/bin/env bash
# Starts the Slicer that build.sh has made, with this project's module: start.sh FOLDER [OPTIONS...]
#
# OPTIONS are Slicer's. Shows its window where DISPLAY says, or on a display of its own that nobody
# sees.
set -euo pipefail
if [ "${1:-}" != --inside ]; then
    here=$(cd "$(dirname "$0")" && pwd)
    folder=${1:?start.sh: say the folder of build.sh}
    shift
    exec "$here/enter.sh" "$folder" bash /helpers/start.sh --inside "$@"
fi
shift
slicer=/build/Slicer
modules=$(echo $slicer/lib/Slicer-*)
mkdir -p "$HOME"
# What the launcher would set.
export SLICER_HOME=$slicer
export PATH=/helpers:$slicer/bin:/usr/local/bin:/usr/bin:/bin
export LD_LIBRARY_PATH=/build/pythonqt/library:$slicer/bin:$modules/qt-loadable-modules:/build/sem/bin
path=$slicer/bin:$slicer/bin/Python
path+=:$modules/qt-loadable-modules:$modules/qt-loadable-modules/Python:$modules/qt-scripted-modules
# CTK's wrapped libraries are in the folder of the libraries.
path+=:/usr/lib/$(gcc -dumpmachine):/usr/lib/python3/dist-packages
export PYTHONPATH=$path:$(python3 -m site --user-site)
# Else Slicer gives itself, and so its workers, the lowest priority.
export SLICER_BACKGROUND_THREAD_PRIORITY=0
# The designer plugins of CTK and of Slicer, for .ui files.
export QT_PLUGIN_PATH=/usr/lib/$(gcc -dumpmachine):$slicer/bin
# Packages are installed beside Debian's, which may not be changed.
export PIP_USER=1 PIP_BREAK_SYSTEM_PACKAGES=1 PIP_ROOT_USER_ACTION=ignore
command=($slicer/bin/SlicerApp-real --no-splash --disable-settings
         --additional-module-paths /project/ElastoIdentify "$@")
[ -z "${DISPLAY:-}" ] || exec "${command[@]}"
# A display of its own, with a window manager, as dialogs want one.
exec xvfb-run -a -s "-screen 0 1600x1000x24 +extension GLX" \
    sh -c 'openbox & manager=$!; "$@"; code=$?; kill $manager; exit $code' start.sh "${command[@]}"
