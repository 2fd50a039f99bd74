# The Slicer extension: one scripted module, nothing to compile.
set(EXTENSION_HOMEPAGE "https://github.com/elastoidentify/SlicerElastoIdentify")
set(EXTENSION_CATEGORY "Quantification")
set(EXTENSION_CONTRIBUTORS "The ElastoIdentify authors")
set(EXTENSION_DESCRIPTION
    "Stiffness of soft tissue from images alone: Lamé constants on a mesh, from images of a block at rest and pushed by a pad of known stiffness."
)
set(EXTENSION_ICONURL
    "https://raw.githubusercontent.com/elastoidentify/SlicerElastoIdentify/main/Resources/ElastoIdentify.png"
)
set(EXTENSION_SCREENSHOTURLS
    "https://raw.githubusercontent.com/elastoidentify/SlicerElastoIdentify/main/docs/pictures/slicer-slice-view.png https://raw.githubusercontent.com/elastoidentify/SlicerElastoIdentify/main/docs/pictures/slicer-3d-view.png"
)
set(EXTENSION_DEPENDS "NA")

include(${Slicer_USE_FILE})
add_subdirectory(ElastoIdentify)
include(${Slicer_EXTENSION_GENERATE_CONFIG})
include(${Slicer_EXTENSION_CPACK})
