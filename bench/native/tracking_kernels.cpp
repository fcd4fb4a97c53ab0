// The tracker's kernels. Compiled once for each instruction set; BGS_TRACKING_TABLE names the result.
// Nothing here allocates, locks or calls into the C++ library: see vec8.h for why.
#include "tracking_kernels.h"

#include <cstring>

namespace bgs {
namespace {

#include "tracking_image.inc"
#include "tracking_match.inc"
#include "tracking_projection.inc"
#include "tracking_bundle.inc"

}  // namespace

extern const TrackingTable BGS_TRACKING_TABLE;
const TrackingTable BGS_TRACKING_TABLE = {shrink, blur, fast_corners, describe, pair_rows, ssd_profile, match_boxes, optimise_pose, bundle};

}  // namespace bgs
