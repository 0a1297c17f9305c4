//! The suite is tested: every planted fault turns those members red that are meant to see it, and the product none.
//!
//! | fault | seen by |
//! |---|---|
//! | uniform instead of cosine rays | A14, A13, also by links |
//! | cosine twice | A14, A13, also by links |
//! | normal flipped | A14, A17, A13 by links |
//! | occlusion off | A17 |
//! | only the far wall occludes | A17, A13, also by links |
//! | last ray dropped | A1, also by links |
//! | ray epsilon of 1e-3 | A14 |
//! | kernel without its 1/π | A1 |
//! | rows too large by 1e-3 | A1, A9 |
//! | red and blue swapped | B3, C4 |
//! | 16-bit coefficients | A1 |
//! | weights not renormalised | A1 |
//! | kernel ignores the side | D8 |
//! | sum in the order of the threads | B6 |
//! | radiance taken for exitance | A1, A14, A1 by links |
//! | albedo applied twice | A1, A13, also by links |
//! | radiosity and irradiance swapped | A13 |
//! | one point duplicated | B11, E8 |
//! | area weights times 1.01 | B11 |
//! | sRGB decoding skipped | C12 |
//! | sky weight halved | C10 |
//! | stops on a small step | A9 |

use hplt_tests::checks::{self, Check};
use hplt_tests::{Stages, faults};

/// The table above.
const SEEN_BY: [(&str, &[&str]); 22] = [
    ("uniform instead of cosine rays", &["A14 parallel plates", "A13 concentric spheres", "A13 by links"]),
    ("cosine twice", &["A14 parallel plates", "A13 concentric spheres", "A13 by links"]),
    ("normal flipped", &["A14 parallel plates", "A17 blocked square", "A13 by links"]),
    ("occlusion off", &["A17 blocked square"]),
    ("only the far wall occludes", &["A17 blocked square", "A13 concentric spheres", "A13 by links"]),
    ("last ray dropped", &["A1 furnace", "A1 by links"]),
    ("ray epsilon of 1e-3", &["A14 parallel plates"]),
    ("kernel without its 1/π", &["A1 furnace"]),
    ("rows too large by 1e-3", &["A1 furnace", "A9 stop on a bound"]),
    ("red and blue swapped", &["B3 permuted channels", "C4 dead channels"]),
    ("16-bit coefficients", &["A1 furnace"]),
    ("weights not renormalised", &["A1 furnace"]),
    ("kernel ignores the side", &["D8 dark room"]),
    ("sum in the order of the threads", &["B6 threads"]),
    ("radiance taken for exitance", &["A1 furnace", "A14 parallel plates", "A1 by links"]),
    ("albedo applied twice", &["A1 furnace", "A13 concentric spheres", "A1 by links", "A13 by links"]),
    ("radiosity and irradiance swapped", &["A13 concentric spheres"]),
    ("one point duplicated", &["B11 areas", "E8 distances"]),
    ("area weights times 1.01", &["B11 areas"]),
    ("sRGB decoding skipped", &["C12 encoded texture"]),
    ("sky weight halved", &["C10 sky"]),
    ("stops on a small step", &["A9 stop on a bound"]),
];

#[test]
fn the_product_passes_every_member() {
    let failed: Vec<String> = checks::ALL
        .iter()
        .filter_map(|check| {
            let start = std::time::Instant::now();
            let verdict = (check.run)(&Stages::SOUND);
            println!("{}: {:.1} s", check.name, start.elapsed().as_secs_f64());
            verdict.err().map(|what| format!("{}: {what}", check.name))
        })
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn every_planted_fault_is_seen_by_the_members_that_are_meant_to() {
    let planted = faults::all();
    assert_eq!(planted.len(), SEEN_BY.len(), "a fault without a line in the table, or the other way round");
    let mut unseen = Vec::new();
    for (name, members) in SEEN_BY {
        let fault = planted.iter().find(|fault| fault.name == name);
        let stages = fault.unwrap_or_else(|| panic!("no fault is called {name}")).stages;
        for member in members {
            let Check { run, .. } = checks::named(member);
            match run(&stages) {
                Err(what) => println!("{name}: {member}: {what}"),
                Ok(()) => unseen.push(format!("{member} does not see \"{name}\"")),
            }
        }
    }
    assert!(unseen.is_empty(), "{unseen:#?}");
}
