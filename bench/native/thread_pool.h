// A small pool: run tasks 0 .. n-1 on all threads. Which thread runs a task never changes a result.
//
// Not OpenMP: torch brings its own copy of that run-time library, and two in one process fight for the cores.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

class ThreadPool {
public:
    explicit ThreadPool(int threads) { resize(threads); }
    ~ThreadPool() { stop(); }
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;

    int threads() const { return static_cast<int>(workers_.size()) + 1; }

    void resize(int threads) {
        std::lock_guard<std::mutex> busy(run_mutex_);
        stop();
        stopping_ = false;
        for (int k = 1; k < threads; ++k) workers_.emplace_back([this, seen = generation_.load()] { work(seen); });
    }

    // Calls task(k) for every k < n and returns when all are done. Calls from several threads wait for each other.
    void run(int n, const std::function<void(int)>& task) {
        std::lock_guard<std::mutex> busy(run_mutex_);
        if (workers_.empty() || n <= 1) {
            for (int k = 0; k < n; ++k) task(k);
            return;
        }
        task_ = &task;
        count_ = n;
        next_.store(0, std::memory_order_relaxed);
        active_.store(static_cast<int>(workers_.size()), std::memory_order_relaxed);
        {
            std::lock_guard<std::mutex> lock(mutex_);
            generation_.fetch_add(1, std::memory_order_release);
        }
        wake_.notify_all();
        drain();
        while (active_.load(std::memory_order_acquire) != 0) pause();
    }

private:
    static void pause() {
#if defined(__x86_64__)
        __builtin_ia32_pause();
#endif
        if (++spins() % 256 == 0) std::this_thread::yield();
    }

    static unsigned& spins() {
        static thread_local unsigned count = 0;
        return count;
    }

    void drain() {
        for (int k; (k = next_.fetch_add(1, std::memory_order_relaxed)) < count_;) (*task_)(k);
    }

    void work(unsigned seen) {
        for (;;) {
            // The stages of one iteration follow each other within microseconds: spin for a moment before sleeping.
            for (int spin = 0; spin < 2000 && generation_.load(std::memory_order_acquire) == seen; ++spin) pause();
            if (generation_.load(std::memory_order_acquire) == seen) {
                std::unique_lock<std::mutex> lock(mutex_);
                wake_.wait(lock, [&] { return generation_.load(std::memory_order_acquire) != seen; });
            }
            seen = generation_.load(std::memory_order_acquire);
            if (stopping_) return;
            drain();
            active_.fetch_sub(1, std::memory_order_release);
        }
    }

    void stop() {
        {
            std::lock_guard<std::mutex> lock(mutex_);
            stopping_ = true;
            generation_.fetch_add(1, std::memory_order_release);
        }
        wake_.notify_all();
        for (auto& worker : workers_) worker.join();
        workers_.clear();
    }

    std::vector<std::thread> workers_;
    std::mutex run_mutex_, mutex_;
    std::condition_variable wake_;
    std::atomic<unsigned> generation_{0};
    std::atomic<int> next_{0}, active_{0};
    std::atomic<bool> stopping_{false};
    const std::function<void(int)>* task_ = nullptr;
    int count_ = 0;
};
