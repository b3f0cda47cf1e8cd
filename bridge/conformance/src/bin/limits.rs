//! Holds the engine of this project against all cases and prints the page of its limits.

use downbeat_conformance::{engines, limits_page, run_all};

fn main() -> Result<(), std::io::Error> {
    // Beside this program, where cargo puts those of one package.
    let peer = std::env::current_exe()?.with_file_name(format!("rtps_peer{}", std::env::consts::EXE_SUFFIX));
    let engine = engines::rtps(peer.exists().then_some(peer));
    let results: Vec<_> = run_all(&engine).inspect(|result| eprintln!("{result}")).collect();
    print!("{}", limits_page(&engine, &results));
    Ok(())
}
