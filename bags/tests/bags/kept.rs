//! The bags of all tests, which `cargo xtask readers` keeps.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use downbeat_bags::{Problem, Reader, check};

use crate::stock_readers;

/// What a stock reader says of bags that it is not made for, with the reason.
const BEYOND_A_READER: &[(&str, &str, &str)] = &[];

/// Bags, of which those without a metadata.yaml are single files, in the folder of a test.
fn bags(folder: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut bags = Vec::new();
    for test in entries(folder) {
        for place in entries(&test) {
            if place.join("metadata.yaml").exists() {
                bags.push(place);
            } else {
                bags.extend(entries(&place));
            }
        }
    }
    bags.sort();
    bags
}

/// Whether a check finds nothing but what others do not mind.
fn is_whole(bag: &Reader) -> bool {
    check(bag, |_| ()).is_ok_and(|check| {
        let matters = |problem: &Problem| !matches!(problem, Problem::NoMetadata | Problem::Lost(_));
        !check.problems.iter().any(matters)
    })
}

#[test]
#[ignore = "an hour: cargo xtask readers"]
fn others_open_every_kept_bag() {
    let kept = std::env::var_os("KEPT_BAGS").expect("KEPT_BAGS: the folder of the kept bags");
    let kept = Path::new(&kept);
    let folder = tempfile::tempdir().unwrap();
    let mut whole = Vec::new();
    let all = bags(kept);
    for (number, bag) in all.iter().enumerate() {
        let Ok(reader) = Reader::open(bag) else { continue };
        if is_whole(&reader) {
            let extension = bag.extension().filter(|_| bag.is_file()).unwrap_or_default();
            let link = folder.path().join(number.to_string()).with_extension(extension);
            symlink(bag, &link).unwrap();
            whole.push((bag, link, reader));
        }
    }
    let readers = stock_readers::read(folder.path());
    let mut known = BTreeMap::new();
    let mut unknown = 0;
    let mut refused_by_any = 0;
    for (bag, link, ours) in &whole {
        let name = bag.strip_prefix(kept).unwrap().display();
        let differences: Vec<_> =
            readers.iter().filter_map(|reader| Some((reader.name, reader.difference(link, ours)?))).collect();
        refused_by_any += usize::from(!differences.is_empty());
        for (reader, difference) in differences {
            let is_known = |(of, says, _): &&(&str, &str, &str)| *of == reader && difference.contains(says);
            if let Some((_, _, reason)) = BEYOND_A_READER.iter().find(is_known) {
                *known.entry((reader, *reason)).or_insert(0) += 1;
            } else {
                unknown += 1;
                println!("{reader}: {name}: {difference:.300}");
            }
        }
    }
    let damaged = all.len() - whole.len();
    println!(
        "{} bags; {damaged} are damaged, as we find too; of the others, {} are read by {} readers",
        all.len(),
        whole.len() - refused_by_any,
        readers.len()
    );
    for ((reader, reason), count) in known {
        println!("{count:>5} refused by {reader}: {reason}");
    }
    assert_eq!(unknown, 0, "bags that a stock reader reads otherwise, without a reason that is known");
}
