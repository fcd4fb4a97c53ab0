// The end of a process whose Python does not come back: a thread that needs no interpreter waits for a moment that is put
// off as long as the run goes on. So a call that never returns, and keeps the interpreter's lock, ends all the same.
#include <fcntl.h>
#include <nanobind/stl/string.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <string>
#include <thread>

#include "bindings.h"

namespace {

using Clock = std::chrono::steady_clock;

struct LastResort {
    std::mutex mutex;
    std::condition_variable changed;
    bool watching = false;
    Clock::time_point end = Clock::time_point::max();
    std::string file, content, message;
};

void write_all(int file, const std::string& text) {
    for (size_t done = 0; done < text.size();) {
        const ssize_t n = write(file, text.data() + done, text.size() - done);
        if (n <= 0) return;
        done += static_cast<size_t>(n);
    }
}

// Written beside the file and renamed, as everything in a run folder is.
[[noreturn]] void end_process(const LastResort& last) {
    const std::string temporary = last.file + ".writing";
    const int file = last.file.empty() ? -1 : open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (file >= 0) {
        write_all(file, last.content);
        close(file);
        std::rename(temporary.c_str(), last.file.c_str());
    }
    write_all(STDERR_FILENO, last.message);
    _exit(1);
}

void watch(LastResort& last) {
    std::unique_lock<std::mutex> lock(last.mutex);
    for (;;) {
        if (last.end == Clock::time_point::max()) last.changed.wait(lock);
        else if (last.changed.wait_until(lock, last.end) == std::cv_status::timeout && Clock::now() >= last.end) end_process(last);
    }
}

// Never destroyed: its thread outlives whatever runs when the process ends.
LastResort& last_resort() {
    static LastResort* const last = new LastResort;
    return *last;
}

void end_in(double seconds, const std::string& file, const std::string& content, const std::string& message) {
    // A part that hangs still has objects of ours when a run ends without it: that is told in other words.
    nb::set_leak_warnings(false);
    LastResort& last = last_resort();
    std::lock_guard<std::mutex> lock(last.mutex);
    last.file = file, last.content = content, last.message = message;
    // Thirty years are as good as never, and whole nanoseconds of them still have room.
    const std::chrono::duration<double> time(std::min(seconds, 1e9));
    last.end = Clock::now() + std::chrono::duration_cast<Clock::duration>(time);
    if (!last.watching) std::thread(watch, std::ref(last)).detach();
    last.watching = true;
    last.changed.notify_one();
}

void end_never() {
    LastResort& last = last_resort();
    std::lock_guard<std::mutex> lock(last.mutex);
    last.end = Clock::time_point::max();
}

}  // namespace

void bind_last_resort(nb::module_& m) {
    m.def("end_process_in", end_in, "seconds"_a, "file"_a, "content"_a, "message"_a);
    m.def("end_process_never", end_never);
}
