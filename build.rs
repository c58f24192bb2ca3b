//! Names the shared library: a host that was linked against one ABI must not load another.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("linux") {
        println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libsketch2pq.so.{}", env!("CARGO_PKG_VERSION_MAJOR"));
    }
}
