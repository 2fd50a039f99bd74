#!/usr/bin/env bash
# Configures and compiles Slicer; build.sh calls it in the Debian sid it has made.
set -euo pipefail
src=/src build=/build here=/helpers jobs=${JOBS:-2}
export CCACHE_DIR=$build/ccache
libraries=/usr/lib/$(gcc -dumpmachine)

python3 "$here/patch_slicer.py" "$src/Slicer"

# ---- what Debian's packages lack

# Of CTK: the two files that wrap a library for PythonQt.
cp "$src"/CTK/CMake/{ctkMacroWrapPythonQtModuleInit.cpp.in,ctkWrapPythonQt.py} "$libraries/cmake/ctk/"
# Of VTK: the class hierarchies of its Qt modules, for which the wrapping of Slicer's classes waits.
hierarchies=$(echo "$libraries"/vtk-9.*/hierarchy/VTK)
for module in RenderingQt GUISupportQt ViewsQt GUISupportQtSQL; do
    [ -e "$hierarchies/vtk$module-hierarchy.txt" ] || touch "$hierarchies/vtk$module-hierarchy.txt"
done
# Names that exported targets leave to the linker: a library of headers only, a switch that is OFF,
# and libraries whose file has a version in its name.
for name in RapidJSON OFF; do
    [ -e "$libraries/lib$name.a" ] || ar cr "$libraries/lib$name.a"
done
for name in itkvnl_algo itkvnl itkvcl itkv3p_netlib itksys ITKCommon; do
    [ -e "$libraries/lib$name.so" ] || ln -s "lib$name-5.4.so" "$libraries/lib$name.so"
done
[ -e "$libraries/libqttesting.so" ] || ln -s libqttesting.so.1 "$libraries/libqttesting.so"

# ---- the two small projects that Slicer needs beside it

common=(-G Ninja -Wno-dev -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF
        -DCMAKE_POLICY_VERSION_MINIMUM=3.5)
if [ ! -e "$build/sem/.complete" ]; then
    cmake "${common[@]}" -S "$src/SlicerExecutionModel" -B "$build/sem" \
        -DSlicerExecutionModel_USE_SERIALIZER=OFF
    cmake --build "$build/sem" -j "$jobs"
    touch "$build/sem/.complete"
fi
if [ ! -e "$build/launcher/.complete" ]; then
    cmake "${common[@]}" -S "$src/AppLauncher" -B "$build/launcher" \
        -DCTKAppLauncher_QT_STATIC_LIBRARIES=OFF -DCTKAppLauncher_QT_VERSION=6 -DCTK_QT_VERSION=6
    cmake --build "$build/launcher" --target CTKAppLauncherLib -j "$jobs"
    touch "$build/launcher/.complete"
fi

# ---- the wrappers of Qt's classes for Python, which Debian's PythonQt is built without

if [ ! -e "$build/pythonqt/.complete" ]; then
    mkdir -p "$build"/pythonqt/{generator,input}
    (
        cd "$build/pythonqt/generator"
        qmake6 "$src/PythonQt/generator/generator.pro" CONFIG+=release
        make -s -j "$jobs"
        cd ../input
        cp "$src"/PythonQt/generator/*.{xml,txt,h} .
        # Only those that Slicer's own modules ask for.
        others='sql|opengl|webkit|webenginewidgets|xmlpatterns|multimedia|qml|quick'
        widgets='MultimediaWidgets|QuickWidgets|OpenGLWidgets|WebKitWidgets'
        sed -i -E "/typesystem_($others)\.xml/d" build_all.txt
        sed -i -E "/include <(Qt($others|$widgets)\/|phonon)/Id" qtscript_masterinclude.h
        ../generator/pythonqt_generator --output-directory="$build/pythonqt" \
            qtscript_masterinclude.h build_all.txt
    )
    cmake -G Ninja -S "$here/pythonqt" -B "$build/pythonqt/library" -DCMAKE_BUILD_TYPE=Release \
        -DCMAKE_CXX_FLAGS_RELEASE=-O0 -DCMAKE_CXX_COMPILER_LAUNCHER=ccache \
        -DSOURCE="$src/PythonQt" -DGENERATED="$build/pythonqt/generated_cpp"
    nice -n 19 ninja -C "$build/pythonqt/library" -j "$jobs"
    touch "$build/pythonqt/.complete"
fi

# ---- Slicer

# What the module needs and what its users have open beside it. Annotations belongs to Markups.
loadable=(Annotations Cameras Colors Data Markups Models Plots Segmentations SubjectHierarchy Tables
          Terminologies Transforms Units ViewControllers Volumes)
scripted=(DataProbe SampleData SegmentEditor SegmentStatistics)
off=(SUPERBUILD USE_CTKAPPLAUNCHER USE_QtTesting USE_SimpleITK USE_TBB USE_VTK_DEBUG_LEAKS
     USE_PYTHONQT_WITH_OPENSSL BUILD_CLI BUILD_DICOM_SUPPORT BUILD_DIFFUSION_SUPPORT
     BUILD_DOCUMENTATION BUILD_EXTENSIONMANAGER_SUPPORT BUILD_APPLICATIONUPDATE_SUPPORT
     BUILD_I18N_SUPPORT BUILD_MULTIMEDIA_SUPPORT BUILD_USAGE_LOGGING_SUPPORT
     BUILD_WEBENGINE_SUPPORT STORE_SETTINGS_IN_APPLICATION_HOME_DIR)
# Modules in Python get their widgets from .ui files through the designer plugins.
on=(USE_PYTHONQT BUILD_vtkAddon BUILD_QT_DESIGNER_PLUGINS INSTALL_NO_DEVELOPMENT)
for library in QT ITK VTK CTK teem SlicerExecutionModel python PythonQt LibArchive RapidJSON JsonCpp
do
    on+=("USE_SYSTEM_$library")
done
options=("${off[@]/%/=OFF}" "${on[@]/%/=ON}")
list() { local IFS=';'; echo "$*"; }
# Slicer sets CMAKE_CXX_FLAGS itself and leaves these for others.
flags="-w -fpermissive -include cstdint -I$here/compat -I/usr/include/gdcm-3.0 -I/usr/include/ctk"

cmake "${common[@]}" -S "$src/Slicer" -B "$build/Slicer" "${options[@]/#/-DSlicer_}" \
    -DADDITIONAL_CXX_FLAGS="$flags" -DCMAKE_CXX_FLAGS_RELEASE="${OPT:--O0} -DNDEBUG" \
    -DCMAKE_C_COMPILER_LAUNCHER=ccache -DCMAKE_CXX_COMPILER_LAUNCHER="$here/precompiled" \
    -DSlicer_REQUIRED_QT_VERSION=6.5 -DSlicer_VTK_VERSION_MAJOR=9 -DSlicer_VTK_VERSION_MINOR=6 \
    -DSlicer_VTK_SMP_IMPLEMENTATION_TYPE=Sequential \
    -DSlicer_FORCED_REVISION=34000 -DSlicer_FORCED_WC_LAST_CHANGED_DATE=2026-08-21 \
    -DSlicer_WC_LAST_CHANGED_DATE=2026-08-21 \
    -DSlicerExecutionModel_DIR="$build/sem" -DCTKAppLauncherLib_DIR="$build/launcher" \
    -DvtkAddon_WRAP_PYTHON=ON -DvtkAddon_SOURCE_DIR="$src/vtkAddon" \
    -DvtkAddon_CMAKE_DIR="$src/vtkAddon/CMake" \
    -DQt6_DIR="$libraries/cmake/Qt6" -DCTK_DIR="$libraries/cmake/ctk" \
    -DTeem_DIR=/usr/lib/Teem-1.12.0 -DPythonQt_DIR="$here/cmake" \
    -DITKInternalEigen3_DIR="$libraries/cmake/ITK-5.4/Modules" \
    -DPYTHON_EXECUTABLE=/usr/bin/python3 -DPython3_EXECUTABLE=/usr/bin/python3 \
    -DSlicer_QTLOADABLEMODULES_ENABLED="$(list "${loadable[@]}")" \
    -DSlicer_QTSCRIPTEDMODULES_ENABLED="$(list "${scripted[@]}")"
# What one compiler stumbles over does not keep the others waiting.
nice -n 19 ninja -C "$build/Slicer" -j "$jobs" -k 0 ${TARGETS:-}
