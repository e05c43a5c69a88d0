//! Compiles the C++ peer, for any x86-64.

fn main() {
    println!("cargo::rerun-if-changed=cpp");
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        .file("cpp/tiny_solver.cpp")
        .define("NDEBUG", None)
        // Eigen's default, 8, sends JᵀJ of 12 × 6 to a kernel for large matrices: a tenth slower.
        .define("EIGEN_CACHEFRIENDLY_PRODUCT_THRESHOLD", "16")
        // Eigen's own vector code warns by the hundred.
        .warnings(false)
        .opt_level(3)
        .flag("-isystem")
        .flag("/usr/include/eigen3")
        .compile("tiny_solver");
}
