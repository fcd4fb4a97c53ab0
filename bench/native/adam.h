// A step of Adam on arrays that Python gave: its checks.
#pragma once

#include <optional>
#include <vector>

#include "bindings.h"
#include "kernels.h"

// All but the gradients; `rates` must outlive it.
bgs::AdamArgs adam_args(Planes& params, Planes& first, Planes& second, const std::optional<Array1>& position_rate, const std::vector<float>& rates, float beta1,
                        float beta2, float epsilon, int step);
