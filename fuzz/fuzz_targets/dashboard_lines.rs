#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tangent_fuzz::dashboard_lines(data));
