// The kernels, eight lanes wide. Compiled once for each instruction set; BGS_TABLE and BGS_ISA name the result.
// Nothing here allocates, locks or calls into the C++ library: see vec8.h for why.
#include "kernels.h"
#include "vec8.h"

namespace bgs {
namespace {

#include "kernels_planes.inc"
#include "kernels_harmonics.inc"
#include "kernels_project.inc"
#include "kernels_raster.inc"
#include "kernels_photometric.inc"
#include "kernels_depth_losses.inc"
#include "kernels_adam.inc"

}  // namespace

extern const KernelTable BGS_TABLE;
const KernelTable BGS_TABLE = {BGS_ISA,           cull, project,       raster_forward, raster_backward, raster_observe, project_backward, photometric,
                               target_statistics, adam, count_normals, normal_loss,    smooth_loss,     geo_loss};

}  // namespace bgs
