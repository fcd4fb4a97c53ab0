#include "engine.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <new>

namespace bgs {

namespace {

std::unique_ptr<ThreadPool>& pool_slot() {
    // Leaked on purpose: joining threads while the interpreter shuts down can hang.
    static auto* slot = new std::unique_ptr<ThreadPool>();
    return *slot;
}

pid_t owner = 0;

}  // namespace

ThreadPool& pool() {
    auto& slot = pool_slot();
    if (slot && owner != getpid()) slot.release();  // after a fork the threads are gone; forget them
    if (!slot) {
        slot = std::make_unique<ThreadPool>(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
        owner = getpid();
    }
    return *slot;
}

void set_threads(int threads) {
    if (threads != pool().threads()) pool().resize(threads);
}

const KernelTable& kernels() {
    // BGS_KERNELS names the best build that may be taken (baseline, avx2), for tests and for hunting down a difference.
    static const KernelTable& chosen = []() -> const KernelTable& {
#if defined(BGS_HAVE_X86_KERNELS)
        const char* wish = std::getenv("BGS_KERNELS");
        const auto at_most = [&](const char* name) { return wish != nullptr && std::strcmp(wish, name) == 0; };
        const bool has_avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
        const bool has_avx512 = has_avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw") &&
                                __builtin_cpu_supports("avx512dq");
        if (has_avx512 && !at_most("baseline") && !at_most("avx2")) return kernels_avx512;
        if (has_avx2 && !at_most("baseline")) return kernels_avx2;
#endif
        return kernels_baseline;
    }();
    return chosen;
}

}  // namespace bgs
