// What all stages share: the thread pool, the kernels of this machine, and scratch memory (it only grows, and is reused).
#pragma once

#include <algorithm>
#include <memory>

#include "kernels.h"
#include "thread_pool.h"

namespace bgs {

// Memory that is never initialised twice and never given back before the end.
template <typename T> class Buffer {
public:
    T* reserve(size_t count) {
        if (count > capacity_) {
            capacity_ = std::max(count, capacity_ + capacity_ / 8);
            data_.reset(static_cast<T*>(::operator new[](capacity_ * sizeof(T), std::align_val_t(64))));
        }
        return data_.get();
    }
    T* data() const { return data_.get(); }
    size_t bytes() const { return capacity_ * sizeof(T); }

private:
    struct Free {
        void operator()(T* p) const { ::operator delete[](p, std::align_val_t(64)); }
    };
    std::unique_ptr<T[], Free> data_;
    size_t capacity_ = 0;
};

ThreadPool& pool();
void set_threads(int threads);
const KernelTable& kernels();

}  // namespace bgs
