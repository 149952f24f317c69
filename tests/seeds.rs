//! Property tests draw the same cases in every run: a test that fails now and then is run again until it passes, and what it found is lost.

use proptest::prelude::ProptestConfig;
use proptest::test_runner::RngSeed;

#[test]
fn property_tests_draw_the_same_cases_every_time() {
    // From `.cargo/config.toml`, which cargo reads for everything that it runs inside the repository.
    assert_ne!(ProptestConfig::default().rng_seed, RngSeed::Random);
}
