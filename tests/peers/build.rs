//! Compiles the C++ peers, once for any x86-64 and once for the machine at hand.

fn main() {
    println!("cargo::rerun-if-changed=cpp");
    for (name, native) in [("portable", false), ("native", true)] {
        let mut build = cc::Build::new();
        build
            .cpp(true)
            .std("c++17")
            .file("cpp/tiny_solver.cpp")
            .define("SOLVE", format!("tiny_solver_{name}").as_str())
            .define("NDEBUG", None)
            // Eigen's default, 8, sends JᵀJ of 12 × 6 to a kernel for large matrices: a tenth slower.
            .define("EIGEN_CACHEFRIENDLY_PRODUCT_THRESHOLD", "16")
            // Eigen's own vector code warns by the hundred.
            .warnings(false)
            // The linker merges templates of the same name: without names of their own one build
            // would run the other's code.
            .define("Eigen", format!("Eigen_{name}").as_str())
            .define("ceres", format!("ceres_{name}").as_str())
            .define("peers", format!("peers_{name}").as_str())
            .opt_level(3)
            .flag("-isystem")
            .flag("/usr/include/eigen3");
        if native {
            build.flag("-march=native");
        }
        build.compile(&format!("tiny_solver_{name}"));
    }
}
